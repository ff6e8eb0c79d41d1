from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from dronemon import __version__, compiled_folder
from dronemon.version import code_version, find_commit


def git(folder: Path, *arguments: str) -> None:
    identity = ["-c", "user.name=Somebody", "-c", "user.email=somebody@example.org"]
    subprocess.run(["git", *identity, *arguments], cwd=folder, check=True, capture_output=True)


def test_version_begins_with_that_of_the_package():
    assert re.fullmatch(
        rf"{re.escape(__version__)}(\+[0-9a-f]{{10,}}(\.changed\.[0-9a-f]{{8}})?)?", code_version()
    )


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_commit_is_the_last_that_changed_the_folder(tmp_path: Path):
    folder = tmp_path / "package"
    folder.mkdir()
    code = folder / "code.py"
    code.write_text("first\n")
    (tmp_path / "notes.md").write_text("notes\n")
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", "notes.md")
    git(tmp_path, "commit", "--quiet", "-m", "notes")
    assert find_commit(folder) is None  # as installed in a checkout of something else
    git(tmp_path, "add", "package")
    git(tmp_path, "commit", "--quiet", "-m", "code")
    committed = find_commit(folder)
    assert committed is not None
    assert re.fullmatch("[0-9a-f]{10,}", committed)
    (tmp_path / "notes.md").write_text("more notes\n")
    git(tmp_path, "commit", "--quiet", "-a", "-m", "more notes")
    assert find_commit(folder) == committed
    states = [committed]
    for text in ("second\n", "third\n"):
        code.write_text(text)
        states.append(str(find_commit(folder)))
        assert states[-1].startswith(f"{committed}.changed.")
    code.write_text("first\n")
    (folder / "new.py").write_text("untracked code runs too\n")
    states.append(str(find_commit(folder)))
    assert len(set(states)) == 4


def test_no_commit_outside_a_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert find_commit(tmp_path) is None
    monkeypatch.setenv("PATH", "")
    assert find_commit(tmp_path) is None


def test_compiled_code_is_kept_apart_for_each_state_of_what_goes_into_it(tmp_path: Path):
    (tmp_path / "planner").mkdir()
    constants = tmp_path / "problem.py"
    constants.write_text("SENSOR_RADIUS_AU = 0.1\n")
    before = compiled_folder(tmp_path)
    assert before == compiled_folder(tmp_path)
    assert before.is_dir()
    constants.write_text("SENSOR_RADIUS_AU = 0.2\n")
    assert compiled_folder(tmp_path) != before


def test_compiled_code_of_a_read_only_installation_goes_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    package = tmp_path / "package"
    package.mkdir()
    (package / "__pycache__").write_text("not a folder\n")  # even root cannot write into it
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert compiled_folder(package).is_relative_to(tmp_path / "home")
    monkeypatch.setenv("HOME", str(package / "__pycache__"))
    assert compiled_folder(package).is_dir()


def test_a_user_without_a_home_has_a_place_for_compiled_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def nobody() -> Path:
        raise RuntimeError("could not determine home directory")

    monkeypatch.setattr(Path, "home", nobody)
    (tmp_path / "__pycache__").write_text("not a folder\n")
    assert compiled_folder(tmp_path).is_dir()
