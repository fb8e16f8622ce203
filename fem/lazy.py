"""Public names of a package, each imported from its module when it is first asked for (PEP 562),
and modules that are called like functions."""

import importlib
import sys
import types
from collections.abc import Callable


def exports(
    package: str, modules: dict[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """(__getattr__, __dir__, __all__) of `package`; modules: {"module": "Name other_name"}."""
    home = {name: module for module, names in modules.items() for name in names.split()}

    def __getattr__(name: str) -> object:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(home[name]), name)

    def __dir__() -> list[str]:
        return sorted(home)

    return __getattr__, __dir__, sorted(home)


def callable_module(name: str, function: Callable) -> None:
    """Let the module `name`, which is also a command, be called as `function`.

    `fem.generate` is the module for python -m fem.generate as soon as anything has imported it, and
    `fem.generate(scene, path)` must still work then. In the module: callable_module(__name__, f).
    """

    class CallableModule(types.ModuleType):
        __call__ = staticmethod(function)

    sys.modules[name].__class__ = CallableModule
