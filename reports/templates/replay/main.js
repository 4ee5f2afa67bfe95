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
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    Object.assign(colours, readColours());
    players.forEach((player) => player.refresh());
  });
  const open = async (root) => {
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
    for (const entry of entries.filter((e) => e.isIntersecting)) {
      watcher.unobserve(entry.target);
      open(entry.target);
    }
  }, { rootMargin: "600px" });
  document.querySelectorAll(".replay").forEach((root) => watcher.observe(root));
}

start();
