"""Command lines: one line and an exit code for what a user can mend; modules that are called."""

import subprocess
import sys
import types

import psutil
import pytest

import fem.generate
from fem.commands import command_line
from fem.data import build
from fem.errors import InputError, SolverStopped, Stop
from fem.lazy import callable_module, exports


@pytest.mark.parametrize(
    "error, code, line",
    [
        (InputError("mu = 0 must be positive"), 2, "error: mu = 0 must be positive\n"),
        (
            SolverStopped(Stop.DIVERGED, "it grew; lower the load"),
            3,
            "stopped: it grew; lower the load\n",
        ),
        (KeyboardInterrupt(), 130, "\ninterrupted; run the same command again\n"),
        (KeyboardInterrupt("add --resume to go on"), 130, "\ninterrupted; add --resume to go on\n"),
    ],
)
def test_errors_that_a_user_can_mend_are_one_line(error, code, line, capsys):
    """Each kind has its exit code; Ctrl-C says how this command goes on, as the exception says."""

    @command_line
    def main():
        raise error

    with pytest.raises(SystemExit) as exit:
        main()
    assert exit.value.code == code and capsys.readouterr() == ("", line)


def test_other_errors_and_results_pass_through():
    """A bug keeps its traceback, and a main may give something back."""

    @command_line
    def main(number: int) -> float:
        """What it says."""
        return 1 / number

    assert main(2) == 0.5 and main.__doc__ == "What it says."
    with pytest.raises(ZeroDivisionError):
        main(0)


def test_generate_is_a_command_and_a_function(monkeypatch):
    """`fem.generate` is the module whose main() is the command, and is called with a scene."""
    assert isinstance(fem.generate, types.ModuleType) and fem.generate.main
    assert fem.generate.generate is build.generate
    with pytest.raises(TypeError, match=r"generate\(\) missing .* 'path'"):
        fem.generate("scene")


def test_a_module_becomes_callable_and_keeps_its_names(monkeypatch):
    """Its attributes stay, arguments and result pass, and other modules are left alone."""
    module = types.ModuleType("doubling", "its text")
    monkeypatch.setitem(sys.modules, "doubling", module)
    callable_module("doubling", lambda x, times=2: x * times)
    assert module(3) == 6 and module("a", times=3) == "aaa"
    assert module.__doc__ == "its text" and not callable(sys)


def test_names_of_a_package_are_imported_when_they_are_asked_for(monkeypatch):
    """exports() finds each name in its module and names the package where there is none."""
    get, names, public = exports("package", {"json": "dumps loads", "not_there": "x"})
    assert get("loads") is __import__("json").loads and names() == public == ["dumps", "loads", "x"]
    with pytest.raises(AttributeError, match="module 'package' has no attribute 'load'"):
        get("load")


@pytest.mark.timing
@pytest.mark.parametrize(
    "words, code", [(["--help"], 0), (["missing.toml"], 2), (["x.toml", "--workers", "two"], 2)]
)
def test_help_and_refusals_answer_within_a_second(words, code):
    """A second of processor time, so that a busy machine does not count."""
    before = psutil.Process().cpu_times()
    command = [sys.executable, "-m", "fem.generate", *words]
    assert subprocess.run(command, capture_output=True).returncode == code
    after = psutil.Process().cpu_times()
    used = after.children_user + after.children_system
    assert used - before.children_user - before.children_system < 1.0
