"""The gate's report for people, for JUnit readers and for GitHub."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from xml.etree import ElementTree

from pmbm.regression.gate import GateReport, SceneReport
from pmbm.regression.verdicts import Verdict


@dataclass(frozen=True)
class Commands:
    """The commands to print beside a failed gate.

    replay : of a scenario and a trial, the command that shows it.
    accept : the command that accepts the change, or None.
    """

    replay: Callable[[str, int], str]
    accept: str | None = None


def in_words(report: GateReport, commands: Commands) -> str:
    """The report as lines of text, the verdict last."""
    if report.same_code:
        return "pass: both trackers are the same code"
    lines = []
    for scene in report.scenes:
        lines += scene_lines(report, scene, commands)
    if report.verdict is Verdict.FAIL and commands.accept is not None:
        lines.append(f"accept the change: {commands.accept}")
    counts = [scene.verdict for scene in report.scenes]
    parts = [f"{counts.count(kind)} {kind}" for kind in Verdict if kind in counts]
    lines.append(f"{report.verdict}: {', '.join(parts)}")
    return "\n".join(lines)


def scene_lines(report: GateReport, scene: SceneReport, commands: Commands) -> list[str]:
    """The lines about one scenario: the verdict's, then what helps to look further."""
    lines = [f"{scene.verdict}  {headline(report, scene)}"]
    if scene.alongside:
        beside = [f"{name} {old:.4g} -> {new:.4g}" for name, (old, new) in scene.alongside.items()]
        lines.append(f"    not gated: {', '.join(beside)}")
    if scene.verdict is not Verdict.PASS:
        where = f"trial {scene.worst}" + ("" if scene.error else f" (loss {scene.worst_loss:.4g})")
        lines.append(f"    worst is {where}: {commands.replay(scene.name, scene.worst)}")
    return lines


def headline(report: GateReport, scene: SceneReport) -> str:
    """One line: the metric, old and new, the interval, the margin, the trials used."""
    if scene.decision is None:
        return f"{scene.name}: the candidate raised in {scene.error}"
    d = scene.decision
    sign = 1 if report.metric.lower_is_better else -1
    text = (
        f"{scene.name}: {report.metric.name} {sign * d.baseline:z.4g} -> "
        f"{sign * d.candidate:z.4g}, loss {d.loss:+z.4g} in [{d.low:.4g}, {d.high:.4g}], "
        f"margin {d.margin:.4g}, {d.trials} trials"
    )
    if d.verdict is Verdict.PASS:
        text += f"; disasters in less than {100 * d.hidden:.2g} % of trials are not excluded"
    if d.worse_within_margin:
        text += "; worse, within the margin"
    if d.equal:
        text += "; all values are equal"
    if d.verdict is Verdict.UNDECIDED and d.trials < d.needs:
        text += f"; this margin needs at least {d.needs} trials unless the candidate is better"
    return text


def junit(report: GateReport, commands: Commands, name: str) -> str:
    """JUnit XML: one test case a scenario; undecided is a skipped one with its reason."""
    suite = ElementTree.Element("testsuite", name=f"pmbm gate {name}")
    counts = {Verdict.FAIL: 0, Verdict.UNDECIDED: 0, Verdict.PASS: 0}
    if report.same_code:
        ElementTree.SubElement(suite, "testcase", classname=name, name="same code")
    for scene in report.scenes:
        counts[scene.verdict] += 1
        case = ElementTree.SubElement(suite, "testcase", classname=name, name=scene.name)
        message = headline(report, scene)
        text = "\n".join(scene_lines(report, scene, commands))
        kind = {Verdict.FAIL: "failure", Verdict.UNDECIDED: "skipped"}.get(scene.verdict)
        if kind is not None:
            ElementTree.SubElement(case, kind, message=message).text = text
        else:
            ElementTree.SubElement(case, "system-out").text = text
    suite.set("tests", str(max(len(report.scenes), 1)))
    suite.set("failures", str(counts[Verdict.FAIL]))
    suite.set("errors", "0")
    suite.set("skipped", str(counts[Verdict.UNDECIDED]))
    root = ElementTree.Element("testsuites")
    root.append(suite)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def github(report: GateReport, commands: Commands) -> str:
    """Workflow commands that GitHub shows as annotations."""
    level = {Verdict.FAIL: "error", Verdict.UNDECIDED: "warning", Verdict.PASS: "notice"}
    lines = []
    for scene in report.scenes:
        text = "\n".join(scene_lines(report, scene, commands))
        title = _escaped(f"pmbm gate: {scene.name} {scene.verdict}", also=",:")
        lines.append(f"::{level[scene.verdict]} title={title}::{_escaped(text)}")
    if report.same_code:
        lines.append("::notice title=pmbm gate::both trackers are the same code")
    return "\n".join(lines)


def _escaped(text: str, also: str = "") -> str:
    for character in "%\r\n" + also:
        text = text.replace(character, f"%{ord(character):02X}")
    return text
