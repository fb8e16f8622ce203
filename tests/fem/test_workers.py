"""Many tasks: in order, with one thread each, on processes or an executor of the user's, kept as
they end."""

import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

from fem.errors import InputError
from fem.workers import available_cores, on_all_cores


def square(number, delay=0.0):
    time.sleep(delay)
    return number**2


def fail_at(number, bad):
    if number == bad:
        time.sleep(0.2)
        raise ZeroDivisionError(number)
    return number


def die_at(number, bad):
    if number == bad:
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def interrupt_at(number, bad, seen):
    if number == bad:
        time.sleep(0.2)
        os.kill(os.getppid(), signal.SIGINT)
        time.sleep(0.2)
    Path(seen, str(number)).touch()
    return number


def threads():
    return max((pool["num_threads"] for pool in threadpool_info()), default=1)


def process():
    return os.getpid(), threading.current_thread().name, threads()


def test_cores_are_counted_everywhere(monkeypatch):
    """At least one; where a process cannot be bound to cores, all of the machine's."""
    assert 1 <= available_cores() <= os.cpu_count()
    monkeypatch.delattr("psutil.Process.cpu_affinity")
    assert available_cores() >= 1


def test_results_are_in_order_and_kept_as_they_end(capsys):
    """The list follows the tasks, `keep` sees each as it ends and replaces it; the bar counts
    both."""
    seen = []

    def keep(task, result):
        seen.append(task[0])
        return -result

    tasks = [(1, 0.6), (2, 0.0), (3, 0.0)]
    assert on_all_cores(square, tasks, "squares", workers=2, keep=keep, before=4) == [-1, -4, -9]
    assert sorted(seen) == [1, 2, 3] and seen[-1] == 1
    bar = capsys.readouterr().err
    assert "squares" in bar and "7/7" in bar and "4/7" in bar


def test_one_task_or_none_needs_no_process():
    """A single task runs in this process, with one thread; none gives an empty list."""
    before = threads()
    ((pid, _, limit),) = on_all_cores(process, [()], "one")
    assert pid == os.getpid() and limit == 1 and threads() == before
    assert on_all_cores(process, [], "none") == []


def test_an_executor_of_the_user_is_used_and_left_open():
    """Threads of the user's pool do the work, with one numerical thread each, and can go on
    afterwards."""
    before = threads()
    with ThreadPoolExecutor(2, "mine") as executor:
        found = on_all_cores(process, [()] * 3, "threads", executor=executor)
        assert executor.submit(square, 3).result() == 9
    assert all(pid == os.getpid() and "mine" in name for pid, name, _ in found)
    assert {limit for *_, limit in found} == {1} and threads() == before


def test_after_an_error_what_has_begun_is_kept_and_the_rest_not_started():
    """The task's own error comes through; of many tasks behind it, only those that had begun
    ran."""
    kept = []
    with pytest.raises(ZeroDivisionError, match="0"), ThreadPoolExecutor(1) as executor:
        on_all_cores(
            fail_at,
            [(n, 0) for n in range(50)],
            "failing",
            executor=executor,
            keep=lambda task, result: kept.append(result),
        )
    assert len(kept) < 5


def test_a_dead_worker_is_one_line_and_the_finished_tasks_are_kept():
    """kill -9 of a worker (as when memory runs out): InputError with the number kept and the
    remedy."""
    kept = []
    with pytest.raises(
        InputError, match=r"died .out of memory.* 1 of 2 runs are kept; run"
    ) as error:
        on_all_cores(
            die_at,
            [(0, 1), (1, 1)],
            "dying",
            workers=2,
            keep=lambda task, result: kept.append(result),
        )
    assert kept == [0] and "with fewer workers" in str(error.value)


@pytest.fixture
def hears_ctrl_c():
    """A process in the background may be deaf to it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interruption_says_how_to_go_on(tmp_path, hears_ctrl_c):
    """Ctrl-C: what has begun ends and is kept, and the exception carries what was done and the
    remedy."""
    kept = []
    with pytest.raises(KeyboardInterrupt) as interrupt:
        on_all_cores(
            interrupt_at,
            [(n, 0, str(tmp_path)) for n in range(40)],
            "interrupted",
            workers=1,
            keep=lambda task, result: kept.append(result),
        )
    ran = sorted(int(item.name) for item in tmp_path.iterdir())
    assert sorted(kept) == ran and 1 <= len(ran) < 10
    assert str(interrupt.value) == (
        f"{len(kept)} of 40 runs are kept; run the same command again to go on"
    )
