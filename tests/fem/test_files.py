"""Files that are whole or not there, and locks that one process holds at a time."""

import errno
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fem.errors import InputError
from fem.files import replacing, save_arrays, vet_output, write_bytes, write_text
from fem.locks import lock


def names(folder):
    return sorted(item.name for item in folder.iterdir())


def test_writers_leave_the_whole_file_alone_in_new_folders(tmp_path):
    """Texts, bytes and arrays come back as they were, missing folders are made, nothing else
    stays."""
    write_text(tmp_path / "a/b/text.txt", "one\ntwo")
    write_bytes(str(tmp_path / "a/b/bytes.bin"), b"\x00\x01")
    save_arrays(tmp_path / "a/b/arrays.npz", x=np.arange(3), name="n")
    folder = tmp_path / "a/b"
    assert (folder / "text.txt").read_text() == "one\ntwo"
    assert (folder / "bytes.bin").read_bytes() == b"\x00\x01"
    with np.load(folder / "arrays.npz") as file:
        assert file["x"].tolist() == [0, 1, 2] and str(file["name"]) == "n"
    assert names(folder) == ["arrays.npz", "bytes.bin", "text.txt"]


@pytest.mark.parametrize(
    "error",
    [
        ValueError("mine"),
        KeyboardInterrupt(),
        OSError("no number"),
        FileNotFoundError(2, "", "other"),
    ],
)
def test_a_failed_block_leaves_the_old_file_and_its_own_exception(error, tmp_path):
    """What the block raises passes through, the old content stays, the partial file goes."""
    path = tmp_path / "kept.txt"
    path.write_text("old")
    with pytest.raises(type(error)) as raised, replacing(path) as partial:
        partial.write_text("half")
        raise error
    assert raised.value is error and not isinstance(raised.value, InputError)
    assert path.read_text() == "old" and names(tmp_path) == ["kept.txt"]


def test_paths_that_cannot_be_written_are_refused_in_one_line(tmp_path):
    """A folder, a parent that is a file, and a name that is too long: InputError that names the
    path."""
    (tmp_path / "file").write_text("")
    (tmp_path / "folder").mkdir()
    for path, reason in (
        (tmp_path / "folder", "is a folder"),
        (tmp_path / "file" / "x.txt", "cannot be written: "),
        (tmp_path / ("n" * 300), os.strerror(errno.ENAMETOOLONG)),
    ):
        with pytest.raises(InputError, match=reason) as error:
            write_text(path, "text")
        assert str(path)[:60] in str(error.value) and "\n" not in str(error.value)
    assert names(tmp_path) == ["file", "folder"] and not names(tmp_path / "folder")


@pytest.mark.skipif(sys.platform == "win32", reason="no pipes with a name")
def test_a_device_or_a_pipe_is_no_output(tmp_path):
    """A file that took its place would take it away from everyone."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, "/dev/null"):
        with pytest.raises(InputError, match="is a device or a pipe"):
            vet_output(path)
    with pytest.raises(InputError, match="is a device or a pipe"):
        write_text(pipe, "text")
    assert pipe.is_fifo()


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of a file to set")
@pytest.mark.parametrize("call", ["write_text(path, 'x' * 99999)", "save_arrays(path, x=zeros)"])
def test_a_full_disk_is_one_line_and_leaves_nothing(call, tmp_path):
    """Where the file cannot grow (as on a full disk) InputError names path, reason and remedy; the
    old file stays."""
    path = tmp_path / "data.bin"
    path.write_bytes(b"old")
    code = (
        "import resource, pathlib, numpy\n"
        "from fem.files import *\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))\n"
        f"path, zeros = pathlib.Path({str(path)!r}), numpy.random.rand(9999)\n"
        f"try: {call}\n"
        "except ValueError as error: print(type(error).__name__, error)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout.startswith("InputError"), result.stderr
    assert os.strerror(errno.EFBIG) in result.stdout and str(path) in result.stdout
    assert result.stdout.count("\n") == 1
    assert names(tmp_path) == ["data.bin"] and path.read_bytes() == b"old"


HOLD = """
import sys, time
from fem.locks import lock
with lock(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""


def holder(path):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "held\n"
    return process


def test_a_lock_names_its_holder_and_ends_with_it(tmp_path):
    """A second process is refused at once with the first one's number; after kill -9 of the first
    the lock is free, and its file goes with the next release."""
    path = tmp_path / "new" / "out.h5"
    process = holder(path)
    try:
        for _ in range(2):  # a refusal does not wipe the note
            with pytest.raises(InputError) as error, lock(path):
                pytest.fail("two hold the lock")
            assert re.search(
                rf"out.h5 is being written by process {process.pid} since 20\d\d-", str(error.value)
            )
            assert "\n" not in str(error.value)
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate()
    with lock(path), lock(tmp_path / "new" / "other.h5"):
        assert names(path.parent) == [".other.h5.lock", ".out.h5.lock"]
    assert not names(path.parent)


def test_a_lock_refuses_its_own_process_and_is_free_after_an_error(tmp_path):
    """Two runs in one process cannot share an output; an error inside frees the lock."""
    with pytest.raises(ZeroDivisionError), lock(tmp_path / "a"):
        with pytest.raises(InputError, match=f"process {os.getpid()}"), lock(tmp_path / "a"):
            pass
        1 / 0  # noqa: B018
    with lock(Path(tmp_path, "a")):
        pass
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"), lock(tmp_path / "file" / "x"):
        pass
