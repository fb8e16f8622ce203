"""Public names of a package, each imported from its module when it is first asked for (PEP 562),
and modules that are called like functions."""

import importlib
import sys
import types
from collections.abc import Callable

# extra of the distribution that brings a library
EXTRAS = {
    **dict.fromkeys(("scipy", "h5py", "meshio", "tqdm", "threadpoolctl"), "fem"),
    **dict.fromkeys(("tomli_w", "filelock", "psutil"), "fem"),
    **dict.fromkeys(("tensorflow", "keras", "matplotlib", "jinja2"), "train"),
    **dict.fromkeys(("tensorflow_model_optimization", "tf_keras", "flatbuffers"), "deploy"),
    "ai_edge_litert": "runtime",
}


def exports(
    package: str, modules: dict[str, str]
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """(__getattr__, __dir__, __all__) of `package`; modules: {"module": "Name other_name"}.

    A name that is a submodule of `package` gives that module. What needs a library that is not
    installed raises ModuleNotFoundError with the extra that brings it.
    """
    home = {name: module for module, names in modules.items() for name in names.split()}

    def __getattr__(name: str) -> object:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            module = importlib.import_module(home[name])
        except ModuleNotFoundError as error:
            library = (error.name or "").partition(".")[0]
            if library not in EXTRAS:
                raise
            raise ModuleNotFoundError(
                f"{package}.{name} needs {library}; pip install 'unet-fem[{EXTRAS[library]}]'",
                name=library,
            ) from None
        return module if home[name] == f"{package}.{name}" else getattr(module, name)

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
