"""What a measurement is worth nothing without: the processor and the versions of the libraries."""

import platform
from importlib.metadata import version
from pathlib import Path


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    return {"python": platform.python_version()} | {
        name: version(name) for name in ("unet-fem", "numpy", "scipy", "h5py")
    }


def processor() -> str:
    """Model name and vector extensions of this machine's processor."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or platform.machine()
    model = next(
        (line.split(":")[1].strip() for line in text.splitlines() if line.startswith("model name")),
        platform.machine(),
    )
    flags = [
        flag
        for flag in ("avx2", "avx512f", "avx512_vnni", "avx512_bf16", "amx_int8", "amx_bf16")
        if f" {flag}" in text
    ]
    return f"{model} ({' '.join(flags)})"
