"""Planners from outside: what the page shows is flown and measured; what is wrong is explained."""

from __future__ import annotations

import importlib
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from dronemon import cli
from dronemon.errors import OptionError
from dronemon.evaluation import options
from dronemon.evaluation.options import PlannerSpec
from dronemon.planner import create_planner
from dronemon.planner.registry import describe_planners

PAGE = (Path(__file__).parents[2] / "docs" / "your-own-planner.md").read_text()
CODE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0]
COMMANDS = re.findall(r"(?m)^    dronemon (.*)$", PAGE)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder that we run in, with the page's planner and some that are wrong."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "my_planner.py").write_text(CODE)
    (tmp_path / "wrong_planners.py").write_text(
        "class Silent:\n    name = 'silent'\n    def reset(self, briefing, roadmap): ...\n"
        "class Demanding:\n    def __init__(self, much): ...\n"
        "class Leaving:\n    def __init__(self): raise SystemExit(3)\n"
        "class Shy(Silent):\n    next_waypoint = print\n    name = property(lambda self: 1 // 0)\n"
        "class Nameless(Silent):\n    next_waypoint = print\n    name = None\n"
        "class Unresettable(Silent):\n    next_waypoint = print\n    reset = None\n"
        "number = 3\n"
    )
    (tmp_path / "broken_planner.py").write_text("import nothing_of_this_name\n")
    (tmp_path / "leaving_planner.py").write_text("import sys\nsys.exit(3)\n")
    yield tmp_path
    for name in ("my_planner", "mine", "wrong_planners", "broken_planner", "leaving_planner"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    "command",
    [pytest.param(c, marks=[pytest.mark.slow] * (not c.startswith("check "))) for c in COMMANDS],
    ids=[c.split()[0] for c in COMMANDS],
)
def test_every_command_of_the_page_works_as_it_stands(
    folder: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setattr(sys, "argv", ["dronemon", *shlex.split(command)])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert not caught.value.code
    if command.startswith("evaluate"):
        assert "my_planner:Curious" in (folder / "runs" / "compared" / "table.md").read_text()


def test_the_page_shows_one_of_each_command() -> None:
    assert [c.split()[0] for c in COMMANDS] == ["check", "fly", "evaluate"]


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("my_planner:Curius", "has no class Curius; its classes are: Curious"),
        ("my_planner:", "not of the form package.module:Class"),
        ("no_such_module:Curious", "run where it lies, or install it"),
        ("broken_planner:Any", "nothing_of_this_name"),
        ("leaving_planner:Any", "SystemExit(3)"),
        ("wrong_planners:Leaving", "SystemExit(3)"),
        ("wrong_planners:Shy", "ZeroDivisionError"),
        ("wrong_planners:Nameless", "has no name"),
        ("wrong_planners:Unresettable", "has no reset"),
        ("wrong_planners:number", "its classes are: Silent, Demanding"),
        ("wrong_planners:Demanding", "without arguments"),
        ("wrong_planners:Silent", "has no next_waypoint"),
    ],
)
def test_what_is_wrong_with_a_planner_is_explained(folder: Path, path: str, words: str) -> None:
    with pytest.raises(OptionError) as caught:
        create_planner(path)
    assert path in str(caught.value)
    assert words in str(caught.value)


EDITIONS = """
import functools
class Learned(Curious):
    files = ("helper.py", "weights/agent.pt")
class Listless(Curious):
    files = "helper.py"
class Nul(Curious):
    files = ("a\\0b",)
class Parted(Curious):
    def __init__(self, strength): ...
class Homeless(Curious):
    __module__ = "nowhere"
strong = functools.partial(Parted, 2.0)
"""
PACKAGE = """
from my_planner import Curious
class Sub(Curious): ...
def make():
    return Curious()
"""


def digest(kind: str) -> str | None:
    """Of a planner as a new process would have it."""
    options._digest_outside.cache_clear()
    for name in [n for n in sys.modules if n.partition(".")[0] in ("my_planner", "mine")]:
        del sys.modules[name]
    importlib.invalidate_caches()
    for cached in Path().rglob("__pycache__"):
        shutil.rmtree(cached)
    return PlannerSpec(kind=kind).files_digest


KINDS = ["my_planner:Curious", "my_planner:strong", "my_planner:Homeless", "mine:Sub", "mine:make"]


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("kind", KINDS)
def test_what_an_edited_planner_flew_is_not_what_it_flies(kind: str) -> None:
    Path("my_planner.py").write_text(CODE + EDITIONS)
    Path("mine").mkdir()
    Path("mine/__init__.py").write_text(PACKAGE)
    before = digest(kind)
    assert before is not None
    assert digest(kind) == before
    Path("my_planner.py").write_text(CODE + EDITIONS + "# edited")
    assert PlannerSpec(kind=kind).files_digest == before  # as it is loaded
    assert digest(kind) != before
    assert digest("tsp") is None


@pytest.mark.usefixtures("folder")
def test_what_a_planner_names_belongs_to_it() -> None:
    Path("my_planner.py").write_text(CODE + EDITIONS)
    with pytest.raises(OptionError, match=r"^helper\.py, which decides an outcome, cannot be read"):
        digest("my_planner:Learned")
    with pytest.raises(OptionError, match=r"has files 'helper\.py', which is no tuple of paths"):
        digest("my_planner:Listless")
    with pytest.raises(OptionError, match="which decides an outcome, cannot be read"):
        digest("my_planner:Nul")
    Path("weights").mkdir()
    digests = set()
    for content in ("1", "2"):
        for name in ("helper.py", "weights/agent.pt"):
            Path(name).write_text(content)
            if Path("weights/agent.pt").exists():
                digests.add(digest("my_planner:Learned"))
    assert len(digests) == 3


def test_weights_are_refused(folder: Path) -> None:
    with pytest.raises(OptionError, match="has no weights"):
        create_planner("my_planner:Curious", checkpoint="x.pt")


def test_an_installed_package_brings_planners_under_their_names(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = folder / "curious-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: curious\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[dronemon.planners]\ncurious = my_planner:Curious\nbroken = broken_planner:Any\n"
    )
    monkeypatch.syspath_prepend(str(folder))
    assert create_planner("curious").name == "curious"
    told = describe_planners()
    assert told["curious"].startswith("Flies to the node")
    assert "cannot be imported" in told["broken"]
    with pytest.raises(OptionError, match=r"did you mean curious\?"):
        create_planner("curios")
