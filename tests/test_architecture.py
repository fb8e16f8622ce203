"""Where a line may live: layers that import downwards only, a base of NumPy alone, imports without
side effects."""

import ast
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for wing in ("fem", "unet_fem")
    for path in sorted((ROOT / wing).rglob("*.py"))
}
TOOLS = sorted((ROOT / "tools").glob("*.py"))
TREES = {name: ast.parse(path.read_text()) for name, path in FILES.items()}

# The shape functions and the laws of the material, which need NumPy alone: what runs online has
# them too.
LAWS = (
    "fem.mesh.element"
    " fem.material.base fem.material.kinematics fem.material.laws"
    " fem.material.neo_hooke fem.material.mooney_rivlin fem.material.ogden"
)

# From the bottom up. A module belongs to the longest of these names that it starts with, and may
# import from its own layer and those before it.
LAYERS = [
    "fem.errors fem.lazy fem.former fem.files fem.ranges fem.memory fem.locks fem.cache"
    " fem.settings fem.workers fem.commands fem.measure.timing fem.measure.machine"
    " fem unet_fem unet_fem.former unet_fem.metrics",
    LAWS,
    "fem.online",
    "fem.mesh",
    "fem.material",
    "fem.contact",
    "fem.solver",
    "fem.data",
    "fem.reduced",
    "fem.measure",
    "fem.generate fem.reduce",
    "unet_fem.runtime",
    "unet_fem.networks",
    "unet_fem.steppers",
    "unet_fem.training",
    "unet_fem.evaluate",
    "unet_fem.deployment",
    "unet_fem.train",
    "unet_fem.study",
    "unet_fem.study.measure",
    "unet_fem.study.stages",
    "unet_fem.study.report",
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names.split()}

COMMANDS = (
    "fem.generate fem.reduce fem.commands"
    " unet_fem.train unet_fem.evaluate unet_fem.runtime.__main__"
)
PACKAGES = "fem", "unet_fem"
BASE = (
    "fem.errors fem.lazy fem.former fem.files fem.ranges fem.cache fem.online unet_fem.former"
    f" {LAWS}"
)
RUNTIME = (
    f"fem.online fem.errors fem.files fem.ranges fem.lazy fem.commands unet_fem.runtime {LAWS}"
)

# The imports inside functions, {(module, imported): why}: a light path must not pay for them.
DEFERRED = {
    (
        "fem.measure.speed",
        "felupe",
    ): "compared with where it is installed; no extra but [test] has it",
    ("unet_fem.deployment.process", "psutil"): "its own memory would count in what is measured",
    ("unet_fem.deployment.process", "resource"): "not on Windows",
    ("unet_fem.deployment.pruning", "tensorflow_model_optimization"): "of [deploy] alone",
    ("unet_fem.deployment.pruning", "tf_keras"): "of [deploy] alone",
    ("unet_fem.deployment.twins", "tf_keras"): "of [deploy] alone",
    ("unet_fem.deployment.smaller_runs", "unet_fem.deployment.pruning"): "of [deploy] alone",
    ("unet_fem.evaluate", "unet_fem.training.judge"): "Keras, for which no refusal waits",
    ("unet_fem.train", "unet_fem.training.fit"): "Keras, for which no refusal waits",
    ("unet_fem.train", "unet_fem.deployment.comparison"): "Keras, for which no refusal waits",
    ("unet_fem.train", "unet_fem.deployment.constitutive_run"): "Keras, for which no refusal waits",
    ("unet_fem.runtime.replay", "h5py"): "of [fem]; the runtime needs it for this command alone",
}
# The calls that end a process in library code, {module: why}.
ENDS = {"fem.workers": "a worker whose parent was killed must not compute on"}


def imported(node, package):
    """The modules of this project that an import statement names."""
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    else:
        assert node.level == 0, f"{package}: imports are absolute here"
        whole = [f"{node.module}.{alias.name}" for alias in node.names]
        names = [name if name in FILES else node.module for name in whole]
    return names


def imports(module):
    """(line, imported module, whether it stands in a function) of every import of a module."""
    found = []

    def visit(node, inside):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Import | ast.ImportFrom):
                for name in imported(child, module):
                    found.append((child.lineno, name, inside))
            elif not (isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)):
                visit(child, inside or isinstance(child, ast.FunctionDef | ast.Lambda))

    visit(TREES[module], False)
    return found


IMPORTS = {module: imports(module) for module in FILES}


def rank(module):
    """The layer of a module."""
    while module not in RANK:
        module = module.rpartition(".")[0]
    return RANK[module]


def within(module, names):
    """Whether a module is one of these, or lies in one."""
    return any(f"{module}.".startswith(f"{name}.") for name in names.split())


def foreign(module):
    """The libraries that a module imports."""
    tops = {name.split(".")[0] for _, name, _ in IMPORTS[module]}
    return tops - {*sys.stdlib_module_names, "fem", "unet_fem"}


def inner(module):
    """(line, name) of the modules of this project that a module imports."""
    return [(line, name) for line, name, _ in IMPORTS[module] if name in FILES]


def named(module):
    """(line, name) of the modules that a table names as "module:function", to import them later."""
    return [
        (node.lineno, match[1])
        for node in ast.walk(TREES[module])
        if isinstance(node, ast.Constant)
        and (match := re.fullmatch(r"([\w.]+):[\w.]+", str(node.value)))
        and match[1] in FILES
    ]


def outside_functions(tree):
    """Every node that is carried out while a module is imported."""
    for child in ast.iter_child_nodes(tree):
        if not isinstance(child, ast.FunctionDef | ast.Lambda):
            yield child
            yield from outside_functions(child)


def test_every_module_has_its_place_in_the_layers():
    packages = {module.split(".")[0] for module in FILES}
    unplaced = [
        module for module in FILES.keys() - RANK.keys() if rank(module) in map(RANK.get, packages)
    ]
    assert not unplaced
    assert [name for name in RANK if name not in FILES] == []


def test_imports_point_down():
    upwards = [
        f"{FILES[module]}:{line} imports {name}, which stands above it"
        for module in FILES
        for line, name in inner(module) + named(module)
        if rank(name) > rank(module)
    ]
    assert not upwards


def test_no_circle():
    graph = {module: {name for _, name in inner(module)} - {module} for module in FILES}
    while leaves := [module for module, names in graph.items() if not names & graph.keys()]:
        for module in leaves:
            del graph[module]
    assert not graph


def test_the_solver_knows_no_network():
    learns = {"unet_fem", "tensorflow", "keras", "tf_keras", "ai_edge_litert"}
    names = {
        name.split(".")[0]
        for module in FILES
        if within(module, "fem")
        for _, name, _ in IMPORTS[module]
    }
    assert not learns & names


def test_the_base_is_numpy_alone_and_the_runtime_adds_litert():
    modules = [name for name in FILES if within(name, BASE) or name in PACKAGES]
    assert {name: foreign(name) - {"numpy"} for name in modules if foreign(name) - {"numpy"}} == {}
    assert {name for module in modules for _, name in inner(module)} <= {*modules}

    modules = [name for name in FILES if within(name, "unet_fem.runtime")]
    more = {name: foreign(name) - {"numpy", "ai_edge_litert"} for name in modules}
    assert {name: libraries for name, libraries in more.items() if libraries} == {
        "unet_fem.runtime.replay": {"h5py"}  # it reads a dataset
    }
    for module in modules:
        assert [name for _, name in inner(module) if not within(name, RUNTIME)] == []


def test_the_runtime_and_the_base_import_with_everything_else_blocked():
    heavy = "scipy h5py meshio tqdm tensorflow keras matplotlib psutil filelock tomli_w".split()
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({heavy}));"
        "import fem, fem.cache, fem.files, fem.online.grid, fem.online.stepper, unet_fem;"
        "import fem.online.reduced;"
        "from unet_fem.runtime import Surrogate; import unet_fem.runtime.__main__;"
        "print(fem.NodeGrid, fem.Stepper, unet_fem.Surrogate)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert not run.returncode, run.stderr


def test_the_library_imports_no_command_line_and_ends_no_process():
    found = []
    for module in FILES.keys() - {*COMMANDS.split()}:
        place = FILES[module]
        found += [
            f"{place}:{line} {name}" for line, name in inner(module) if name in COMMANDS.split()
        ]
        for node in ast.walk(TREES[module]):
            text = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            ends = text in {"sys.exit", "os._exit", "exit", "quit", "SystemExit"}
            if ends and module not in ENDS:
                found.append(f"{place}:{node.lineno} {text}")
    assert not found


def test_an_import_changes_nothing_outside_itself():
    """No backend, style, environment, warning filter or global policy is set by an import."""
    calls = (
        "matplotlib.use plt.switch_backend os.environ rcParams set_global_policy putenv"
        " filterwarnings simplefilter setLevel basicConfig"
    ).split()
    found = []
    for module in FILES.keys() - {*COMMANDS.split()}:
        for node in outside_functions(TREES[module]):
            texts = []
            if isinstance(node, ast.Call) and ast.unparse(node.func) != "os.environ.get":
                texts = [ast.unparse(node.func)]
            elif isinstance(node, ast.Assign | ast.AugAssign | ast.Delete):
                targets = node.targets if not isinstance(node, ast.AugAssign) else [node.target]
                texts = [ast.unparse(target) for target in targets]
            for text in texts:
                if any(call in text for call in calls):
                    found.append(f"{FILES[module]}:{node.lineno} {text}")
    assert not found


def test_imports_inside_functions_are_few_and_each_has_a_reason():
    found = {
        (module, name) for module, rows in IMPORTS.items() for _, name, inside in rows if inside
    }
    assert found == DEFERRED.keys()


def public_functions(tree):
    """Every function and method that a user may call: no name with an underscore but __init__ and
    __call__."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node)
        elif isinstance(node, ast.FunctionDef):
            if not node.name.startswith("_") or node.name in ("__init__", "__call__"):
                yield node


def test_public_functions_are_annotated_and_documented():
    bare = []
    for module, tree in TREES.items():
        for node in public_functions(tree):
            args = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            args += [arg for arg in (node.args.vararg, node.args.kwarg) if arg]
            untyped = [
                arg.arg for arg in args if not arg.annotation and arg.arg not in ("self", "cls")
            ]
            if untyped or not node.returns:
                bare.append(f"{FILES[module]}:{node.lineno} {node.name} {untyped}")
    assert not bare


def test_no_line_uses_an_import_path_of_the_last_version():
    import fem.former
    import unet_fem.former

    old = {
        f"{module}.{word.partition(':')[0]}"
        for module, homes in (fem.former.FEM | unet_fem.former.FORMER).items()
        for names in homes.values()
        for word in names.split()
    }
    paths = [*FILES.values(), *TOOLS, *(ROOT / "tests").rglob("test_*.py")]
    for path in paths:
        if path.name == "test_former_names.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                names = {f"{node.module}.{alias.name}" for alias in node.names}
                assert not names & old, f"{path}:{node.lineno}"
