"""Files appear whole or not at all."""

import os

import pytest

from rollkane.files.atomic_file import write_whole


def test_writes_and_replaces(tmp_path):
    target = tmp_path / "a.bin"
    write_whole(target, b"first")
    write_whole(target, b"second")
    assert target.read_bytes() == b"second"
    assert os.listdir(tmp_path) == ["a.bin"]


def test_mode_is_that_of_any_new_file(tmp_path):
    (tmp_path / "plain").write_bytes(b"")
    write_whole(tmp_path / "whole", b"")
    assert (tmp_path / "whole").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_failure_leaves_what_was_there(tmp_path, monkeypatch):
    target = tmp_path / "a.bin"
    target.write_bytes(b"old")

    def refuse(*_):
        raise OSError("disc full")

    for name in ("replace", "fsync"):
        with monkeypatch.context() as broken:
            broken.setattr(os, name, refuse)
            with pytest.raises(OSError, match="disc full"):
                write_whole(target, b"new")
        assert target.read_bytes() == b"old"
        assert os.listdir(tmp_path) == ["a.bin"]


def test_follows_a_link(tmp_path):
    (tmp_path / "real").write_bytes(b"old")
    (tmp_path / "link").symlink_to("real")
    write_whole(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_bytes() == b"new"


def test_refuses_what_is_no_file(tmp_path):
    with pytest.raises(OSError, match="not an ordinary file"):
        write_whole(tmp_path, b"")
    with pytest.raises(FileNotFoundError, match="does not exist"):
        write_whole(tmp_path / "none" / "a.bin", b"")
