"""The house keeps its layers: each module imports only from those before it."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

LAYERS = [
    {"pmbm.arrays", "pmbm.errors", "pmbm.durable", "pmbm.intervals", "pmbm.labels"}
    | {"pmbm.validation", "pmbm.types", "pmbm.geometry", "pmbm.score", "pmbm.provenance"}
    | {"pmbm.kernels", "pmbm.seeding", "pmbm.tables", "pmbm.wording"},
    {"pmbm.assignment", "pmbm.filter", "pmbm.baselines", "pmbm.metrics", "pmbm.datasets"}
    | {"pmbm.fitting"},
    {"pmbm.named_modules", "pmbm.tracking", "pmbm.study", "pmbm.regression", "pmbm.tune"}
    | {"pmbm.by_sensor", "pmbm.external"},
    {"pmbm.sim"},
    {"pmbm.reports"},
    {"pmbm.testing"},
    {"pmbm.cli", "pmbm.pytest_plugin"},
    {"pmbm.__main__"},
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
SIBLINGS = {
    "pmbm.assignment": set(),
    "pmbm.filter": {"pmbm.assignment"},
    "pmbm.fitting": {"pmbm.filter"},
    "pmbm.baselines": {"pmbm.assignment"},
    "pmbm.metrics": set(),
    "pmbm.datasets": {"pmbm.metrics"},
}
"""In the second layer, who may import whom besides itself."""

ONLY_IN = {
    "highway_env": {"sim/world/highway/env.py"},
    "hypothesis": {"sim/search/strategies.py"},
    "trackeval": set(),
    "motmetrics": set(),
    "stonesoup": set(),
    "pickle": set(),
}
"""Packages that only these modules may import, or none."""

PYDANTIC_DOORS_ARE_LAZY_FOR = {"pmbm.filter", "pmbm.metrics", "pmbm.baselines", "pmbm.assignment"}


def modules():
    for top in ("pmbm", "sim", "reports"):
        # The links within pmbm would show sim and reports twice.
        links = [path for path in (ROOT / top).iterdir() if path.is_symlink()]
        for path in sorted((ROOT / top).rglob("*.py")):
            if not any(link in path.parents for link in links):
                yield path


def dotted(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    if parts[0] in ("sim", "reports"):
        # Where they stand in the repository; they are installed within pmbm.
        parts = ("pmbm", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(module):
    """The entry of LAYERS that a dotted module name belongs to."""
    parts = module.split(".")
    for length in (2, 1):
        name = ".".join(parts[:length])
        if name in RANK:
            return name
    return None


def imports(path):
    package = dotted(path).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typing_only = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If)
        and isinstance(node.test, ast.Name)
        and node.test.id == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            name = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                yield node.lineno, f"{name}.{alias.name}"


def violations(path):
    here = room(dotted(path))
    if here is None and dotted(path) != "pmbm":
        return [f"{path.relative_to(ROOT)} is in no layer"]
    found = []
    for line, name in imports(path):
        there = room(name)
        place = f"{path.relative_to(ROOT)}:{line} imports {name}"
        if there is not None and here is not None and there != here:
            if RANK[there] > RANK[here]:
                found.append(f"{place}: a later layer")
            elif RANK[there] == RANK[here] == 1 and there not in SIBLINGS[here]:
                found.append(f"{place}: a neighbour")
            elif RANK[there] == RANK[here] == len(LAYERS) - 1:
                found.append(f"{place}: nobody imports a composition root")
        allowed = ONLY_IN.get(name.split(".")[0])
        if allowed is not None and path.relative_to(ROOT).as_posix() not in allowed:
            found.append(f"{place}: only {', '.join(sorted(allowed)) or 'tests'} may")
        if name.split(".")[0] == "pydantic" and here in PYDANTIC_DOORS_ARE_LAZY_FOR:
            found.append(f"{place}: pydantic stands at the doors of files alone")
    return found


@pytest.mark.parametrize("path", list(modules()), ids=dotted)
def test_each_module_imports_only_from_layers_before_it(path):
    assert violations(path) == []


def test_the_layer_test_sees_a_planted_violation(tmp_path, monkeypatch):
    planted = tmp_path / "pmbm" / "metrics" / "bad.py"
    planted.parent.mkdir(parents=True)
    planted.write_text(
        "from pmbm.filter import PMBMTracker\nimport pmbm.sim.world\nimport pickle\n"
    )
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    assert [v.split(": ")[-1] for v in violations(planted)] == [
        "a neighbour",
        "a later layer",
        "only tests may",
    ]


def imported_modules(paths):
    """Module -> those of these modules that it imports anywhere, inside functions too."""
    known = {dotted(path): path for path in paths}
    graph = {}
    for module, path in known.items():
        named = {name for _, name in imports(path)}
        graph[module] = {n if n in known else n.rpartition(".")[0] for n in named} & set(known)
    return {module: others - {module} for module, others in graph.items()}


def circle(graph):
    """Modules of which each imports the next, and the last the first; none where there are none."""
    done = set()
    for begin in graph:
        trail, ahead = [begin], [iter(graph[begin])]
        while trail:
            following = next(ahead[-1], None)
            if following is None:
                done.add(trail.pop())
                ahead.pop()
            elif following in trail:
                return trail[trail.index(following) :]
            elif following not in done:
                trail.append(following)
                ahead.append(iter(graph[following]))
    return []


def test_no_module_imports_itself_by_way_of_others():
    assert circle(imported_modules(modules())) == []


def test_the_test_of_circles_sees_a_planted_one(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    room = tmp_path / "pmbm" / "metrics"
    room.mkdir(parents=True)
    (room / "a.py").write_text("import pmbm.metrics.b\n")
    (room / "b.py").write_text("from pmbm.metrics import c\n")
    (room / "c.py").write_text("def late():\n    from pmbm.metrics.a import name\n")
    (room / "d.py").write_text("import pmbm.metrics.a\n")
    found = circle(imported_modules(sorted(room.glob("*.py"))))
    assert sorted(found) == ["pmbm.metrics.a", "pmbm.metrics.b", "pmbm.metrics.c"]


def test_nothing_evaluates_or_unpickles_data():
    forbidden = {"eval", "exec", "compile"}
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in forbidden, f"{path}:{node.lineno}"
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert getattr(node.value, "value", None) is False, f"{path}:{node.value.lineno}"


def writes_in_place(path):
    """Lines of a module that write to a file otherwise than through pmbm.durable."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        function, given = node.func, [*node.args, *(word.value for word in node.keywords)]
        name = getattr(function, "attr", None) or getattr(function, "id", None)
        first = given[0] if given else None
        # What goes into a buffer, or comes back as a value, is no file yet.
        elsewhere = isinstance(first, ast.Name) and first.id in ("buffer", "text", "picture")
        elsewhere |= isinstance(first, ast.Constant) and first.value is None
        if name in ("to_csv", "to_parquet", "to_json", "savefig", "save", "dump") and (
            isinstance(function, ast.Attribute) and not elsewhere
        ):
            yield node.lineno
        modes = given[:1] if isinstance(function, ast.Attribute) else given[1:2]
        if name == "open" and any(
            isinstance(mode, ast.Constant) and set(str(mode.value)) & set("wax") for mode in modes
        ):
            yield node.lineno
        if name in ("write_text", "write_bytes"):
            yield node.lineno


def test_files_are_written_through_the_durable_replace_alone(tmp_path):
    for path in modules():
        if path != ROOT / "pmbm" / "durable.py":
            assert list(writes_in_place(path)) == [], path
    planted = tmp_path / "planted.py"
    planted.write_text(
        "path.write_text(text)\nopen(path, 'w')\npath.open('a')\nfigure.savefig(path)\n"
        "table.to_csv(path)\ntable.to_csv(None)\nfigure.savefig(buffer)\npath.open()\n"
    )
    assert list(writes_in_place(planted)) == [1, 2, 3, 4, 5]


def loaded_by(statement, *names):
    code = f"import sys\n{statement}\nprint([n for n in {names!r} if n in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return ast.literal_eval(done.stdout)


HEAVY = ("numpy", "scipy", "highway_env", "gymnasium", "pandas", "matplotlib", "pydantic", "click")


def test_importing_the_package_loads_nothing_heavy():
    assert loaded_by("import pmbm", *HEAVY) == []
    assert loaded_by("import pmbm.sim", *HEAVY) == []


def test_help_loads_no_numpy():
    statement = "from pmbm.cli import group\ngroup.main(['--help'], standalone_mode=False)"
    done = subprocess.run(
        [sys.executable, "-c", f"{statement}\nimport sys\nassert 'numpy' not in sys.modules"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "pmbm run truck_occlusion" in done.stdout


def test_every_public_name_can_be_had():
    import pmbm

    for name in pmbm.__all__:
        assert getattr(pmbm, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = pmbm.nonsense
