"""The memory of this process, on any system.

psutil is imported where it is used: its own memory would count where peak_mb needs none of it.
"""

from pathlib import Path


def resident_mb() -> float:
    """Resident memory in MB, now."""
    import psutil

    return psutil.Process().memory_info().rss / 2**20


def peak_mb() -> float:
    """The most resident memory in MB that this process has had."""
    try:  # Linux, where ru_maxrss of a child starts at the size of the process that forked it
        status = Path("/proc/self/status").read_text()
        return float(status.split("VmHWM:")[1].split()[0]) / 1024
    except (OSError, IndexError):
        pass
    try:  # macOS, in bytes
        import resource
    except ImportError:  # Windows
        import psutil

        return psutil.Process().memory_info().peak_wset / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
