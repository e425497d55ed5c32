"""Files are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from tubeopt.errors import InputError
from tubeopt.files.files import atomic_write, read_text, remove_unfinished, write_text


def test_directories_are_made_and_nothing_else_is_left(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b.txt"
    write_text(path, "å\n")
    assert read_text(path) == "å\n"
    assert [*path.parent.iterdir()] == [path]


@pytest.mark.parametrize("interruption", [RuntimeError, KeyboardInterrupt])
def test_an_interruption_leaves_the_old_file(tmp_path: Path, interruption: type[BaseException]) -> None:
    path = tmp_path / "a.txt"
    write_text(path, "old")

    def write_half() -> None:
        with atomic_write(path) as temporary:
            temporary.write_text("ne")
            assert temporary.suffix == path.suffix
            assert read_text(path) == "old"
            raise interruption

    with pytest.raises(interruption):
        write_half()
    assert read_text(path) == "old"
    assert [*tmp_path.iterdir()] == [path]


def test_a_process_that_is_ended_leaves_no_half(tmp_path: Path) -> None:
    def end_half_way() -> None:
        with atomic_write(tmp_path / "a.txt") as temporary:
            temporary.write_text("ha")
            remove_unfinished()
            assert not [*tmp_path.iterdir()]

    with pytest.raises(InputError, match="cannot be written"):
        end_half_way()
    with atomic_write(tmp_path / "a.txt") as temporary:
        temporary.write_text("whole")
    remove_unfinished()
    assert read_text(tmp_path / "a.txt") == "whole"


def test_the_file_gets_the_permissions_that_any_new_file_gets(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    write_text(tmp_path / "atomic", "")
    assert (tmp_path / "atomic").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "directory").mkdir()
    with pytest.raises(InputError, match=r"x: cannot be written: "):
        write_text(tmp_path / "file" / "x", "")
    with pytest.raises(InputError, match=r"directory: cannot be written: Is a directory$"):
        write_text(tmp_path / "directory", "")
