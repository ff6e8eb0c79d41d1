"""Every import points to a lower layer, and foreign packages stay in their place."""

from __future__ import annotations

import ast
import functools
from pathlib import Path

ROOT = Path(__file__).parents[1]
LAYERS = {
    "errors": 0,
    "version": 0,
    "problem": 0,
    "types": 0,
    "frames": 0,
    "clock": 0,
    "events": 0,
    "outline": 0,
    "arena": 0,
    "sensor": 0,
    "energy": 0,
    "fence": 0,
    "mission": 0,
    "card": 0,
    "durable": 0,
    "json_values": 0,
    "workers": 0,
    "cluster": 0,
    "waiting": 0,
    "terminal": 0,
    "palette": 0,
    "outside": 0,
    "hindsight": 0,
    "sightings": 0,
    "belief": 1,
    "roadmap": 1,
    "policy": 1,
    "vision": 1,
    "world": 1,
    "guidance": 1,
    "guard": 1,
    "preflight": 1,
    "planner": 2,
    "env": 2,
    "vehicle": 3,
    "camera": 3,
    "viz": 3,
    "recorder": 3,
    "runner": 4,
    "training": 4,
    "evaluation": 4,
    "gym": 4,
    "assembly": 5,
    "cli": 5,
    "flight_options": 1,
    "explain": 5,
    "export": 5,
    "report": 5,
    "viewing": 5,
    "detecting": 5,
    "rewatching": 5,
    "calibrating": 5,
    "connections": 5,
    "feasibility": 5,
    "simulator": 5,
}
ORDER_IN_LAYER_0 = (
    "errors",
    "version",
    "problem",
    "types",
    "arena",
    "frames",
    "outline",
    "clock",
    "events",
    "sensor",
    "energy",
    "fence",
    "mission",
    "card",
    "durable",
    "json_values",
    "workers",
    "cluster",
    "waiting",
    "terminal",
    "palette",
    "outside",
    "hindsight",
    "sightings",
)
ALLOWED = {3: {0}, 4: {0, 1, 2}, 5: {0, 1, 2, 3, 4, 5}}
PLACES = {
    "mavsdk": {"vehicle"},
    "rerun": {"viz"},
    "cv2": {"vision", "camera", "explain"},
    "pymavlink": {"vehicle"},
    "matplotlib": {"evaluation", "explain", "report"},
    "shapely": {"arena", "export", "outline"},
    "defusedxml": {"outline"},
    "gymnasium": {"gym"},
    "ray": {"cluster"},
}


@functools.cache
def _imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    return names


def _packages(names: set[str], root: str) -> set[str]:
    return {n.split(".")[1] for n in names if n.startswith(f"{root}.")}


def _sources() -> list[tuple[str, Path]]:
    package = ROOT / "dronemon"
    files = [p for p in package.rglob("*.py") if p != package / "__init__.py"]
    return [(p.relative_to(package).parts[0].removesuffix(".py"), p) for p in files]


def _may_import(importer: str, imported: str) -> bool:
    layer, other = LAYERS[importer], LAYERS[imported]
    if importer == imported:
        return True
    if layer == 0:
        return imported in ORDER_IN_LAYER_0[: ORDER_IN_LAYER_0.index(importer)]
    if importer == "runner":
        return other <= 3
    if layer in ALLOWED:
        return other in ALLOWED[layer]
    return other < layer


def test_every_package_has_a_layer():
    assert {name for name, _ in _sources()} <= set(LAYERS)


def test_imports_point_to_lower_layers():
    wrong = [
        f"{path.relative_to(ROOT)} imports dronemon.{imported}"
        for importer, path in _sources()
        for imported in _packages(_imports(path), "dronemon") & set(LAYERS)
        if not _may_import(importer, imported)
    ]
    assert wrong == []


def test_foreign_packages_stay_in_their_place():
    wrong = [
        f"{path.relative_to(ROOT)} imports {foreign}"
        for importer, path in _sources()
        for foreign, places in PLACES.items()
        if {n.split(".")[0] for n in _imports(path)} & {foreign} and importer not in places
    ]
    assert wrong == []


def test_only_one_kind_of_console_is_written_to():
    """It keeps from terminals what commands them."""
    makers = {importer for importer, path in _sources() if "rich.console.Console" in _imports(path)}
    assert makers == {"terminal"}


def test_application_and_simulator_meet_only_outside():
    for _, path in _sources():
        assert "sim" not in {n.split(".")[0] for n in _imports(path)}, path
    for path in (ROOT / "sim").rglob("*.py"):
        layers = {LAYERS[p] for p in _packages(_imports(path), "dronemon") & set(LAYERS)}
        assert layers <= {0, 1}, path


def test_a_wrong_arrow_is_found():
    assert not _may_import("belief", "roadmap")
    assert not _may_import("mission", "vehicle")
    assert not _may_import("types", "frames")
    assert not _may_import("training", "runner")
    assert _may_import("planner", "belief")
