// Colours come from the page's style sheet, so light and dark are decided in one place.

function readColours() {
  const style = getComputedStyle(document.documentElement);
  const value = (name) => style.getPropertyValue(`--${name}`).trim();
  const trackers = [0, 1, 2, 3, 4].map((i) => value(`tracker-${i}`));
  const identities = [0, 1, 2, 3, 4, 5, 6].map((i) => value(`identity-${i}`));
  const family = style.getPropertyValue("--sans").trim();
  return {
    tracker: (i) => trackers[i % trackers.length],
    identity: (i) => identities[i % identities.length],
    font: (size, weight = 500) => `${weight} ${size}px ${family}`,
    heat: [1, 3, 5].map((i) => parseInt(value("heat").slice(i, i + 2), 16)),
    stage: value("stage"), ink: value("ink"), soft: value("soft"), faint: value("faint"),
    line: value("line"), hair: value("hair"), road: value("road"), building: value("building"),
    unseen: value("unseen"), truth: value("truth"), truthFill: value("truth-fill"),
    detection: value("detection"), detectionText: value("detection-text"), error: value("error"),
    gospa_localisation: value("localisation"), gospa_missed: value("missed"), gospa_false: value("false"),
  };
}

function start() {
  const colours = readColours();
  const players = [];
  const opened = new Set();
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    Object.assign(colours, readColours());
    players.forEach((player) => player.refresh());
  });
  // Paper is light, whatever the screen is.
  window.matchMedia("print").addEventListener("change", () => {
    Object.assign(colours, readColours());
    players.forEach((player) => player.draw());
  });
  const open = async (root) => {
    watcher.unobserve(root);
    if (opened.has(root)) return;
    opened.add(root);
    try {
      const data = JSON.parse(document.getElementById(root.dataset.replay).textContent);
      players.push(new Player(root, await decode(data), colours));
    } catch (error) {
      root.querySelector(".stages").textContent = `This replay cannot be shown: ${error.message}`;
      console.error(error);
    }
  };
  // A replay is unpacked when it comes near the screen.
  const watcher = new IntersectionObserver((entries) => {
    entries.filter((e) => e.isIntersecting).forEach((entry) => open(entry.target));
  }, { rootMargin: "600px" });
  const roots = [...document.querySelectorAll(".replay")];
  roots.forEach((root) => watcher.observe(root));
  // The others when there is time, so that they are there when the page is printed.
  const idle = window.requestIdleCallback ?? ((work) => setTimeout(work, 200));
  const rest = () => {
    const next = roots.find((root) => !opened.has(root));
    if (next) open(next).then(() => idle(rest));
  };
  window.addEventListener("load", () => idle(rest));
}

start();
