"""Loading of compiled kernels, without the compiler.

Code on disk is loaded by LLVM, and called by a function of the same file that converts Python's
arguments. Both need some C functions of numba, but not its compiler: the import of numba takes
longer than a small program. The compiler is imported where code is missing.

    Python --calls--> f-*.wrapper --needs--> f-*.code --needs--> g-*.code

A file lists the files that its code refers to, with the names of their functions. All of them are
loaded at once, or none if one of them is missing or has a function of another name.
"""

from __future__ import annotations

import builtins
import ctypes
import hashlib
import math
import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterable
from functools import cache, cached_property
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, cast

import llvmlite
from llvmlite import binding

from cnc.compiled import code_cache

PORTABLE = ("generic", "")
"""Name and features of the processor for which installed code was compiled."""


class Code(NamedTuple):
    """Contents of a file of compiled code.

    Attributes:
        symbol: name of the function.
        needs: names of the functions to which this code refers, by the file that has them.
        code: an object file.
        rest: for a kernel what the compiler needs to compile its callers; for the conversion of
            arguments name and contents of its environment.
    """

    symbol: str
    needs: dict[str, str]
    code: bytes
    rest: bytes


def read(file: str) -> Code | None:
    """Return the contents of a file; None if there is none, or it is damaged."""
    data = code_cache.find(file)
    return None if data is None else Code._make(pickle.loads(data))


def keep(file: str, code: Code) -> None:
    """Write a file."""
    code_cache.keep(file, pickle.dumps(tuple(code)))


@cache
def host() -> tuple[str, str]:
    """Return name and features of the processor for which kernels are compiled.

    The variables are numba's.
    """
    name = os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name()
    features = os.environ.get("NUMBA_CPU_FEATURES")
    if features is None:
        features = "" if name.lower() == "generic" else _features()
    return name, features


def _features() -> str:
    try:
        features = str(binding.get_host_cpu_features().flatten())
    except RuntimeError:  # LLVM does not know those of this processor
        features = ""
    return f"{features} {os.environ.get('NUMBA_ENABLE_AVX', '')}".strip()


@cache
def version(processor: tuple[str, str]) -> tuple[str, ...]:
    """Return everything besides the kernels on which their code depends.

    Args:
        processor: name and features.
    """
    numba = (_numba() / "_version.py").read_text()
    digest = hashlib.sha256(numba.encode()).hexdigest()
    return binding.get_process_triple(), *processor, digest, llvmlite.__version__


def file_names(folder: str, name: str, types: str, suffix: str) -> list[str]:
    """Return the files in which the code of a kernel may be, the first to look at first.

    Args:
        folder: folder of the kernel's source file.
        name: name of the kernel.
        types: the types of its arguments.
        suffix: ``.code``, or ``.wrapper`` for the function that Python calls.
    """
    files = []
    for processor in dict.fromkeys((PORTABLE, host())):
        key = hashlib.sha256(repr((types, version(processor))).encode()).hexdigest()
        files.append(f"{folder}/{name}-{key[:16]}{suffix}")
    return files


def _numba() -> Path:
    """Return the folder of numba, which is not imported."""
    spec = find_spec("numba")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("No module named 'numba'", name="numba")
    return Path(spec.origin).parent


def _extension(name: str) -> ModuleType:
    """Import a C module of numba, but not the packages around it."""
    if name not in sys.modules:
        folder = _numba().joinpath(*name.split(".")[1:-1])
        spec = PathFinder.find_spec(name, [str(folder)])
        if spec is None or spec.loader is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        sys.modules[name] = module = module_from_spec(spec)
        spec.loader.exec_module(module)
    return sys.modules[name]


class Loader:
    """Compiled code in memory.

    Attributes:
        files: the files that have been loaded, with the names of their functions.
    """

    def __init__(self) -> None:
        self.files: dict[str, str] = {}
        self._symbols: set[str] = set()
        self._entries: dict[str, Callable[..., Any]] = {}
        self._lock = threading.RLock()

    def entry(self, file: str, variables: dict[str, Any]) -> Callable[..., Any] | None:
        """Return the function of a file by which Python calls a kernel.

        Args:
            file: the file.
            variables: those of the kernel's module.

        Returns:
            The function; None if the file, or one that it needs, is missing, damaged, or not the
            one with which the file was compiled.
        """
        with self._lock:
            if file not in self._entries:
                code = read(file)
                if code is None or not self._load({file: code}):
                    return None
                self._entries[file] = self._function(code, variables)
            return self._entries[file]

    def _load(self, found: dict[str, Code]) -> bool:
        """Load some files and those that they need; return False if one of them is not right.

        LLVM does not check names: a call of a function that is not there ends the process.
        """
        waiting = [need for code in found.values() for need in code.needs.items()]
        while waiting:
            file, symbol = waiting.pop()
            if file not in self.files and file not in found:
                code = read(file)
                if code is None:
                    return False
                found[file] = code
                waiting += code.needs.items()
            if symbol != (self.files[file] if file in self.files else found[file].symbol):
                return False
        for file, code in found.items():
            self.files[file] = code.symbol
            if code.symbol not in self._symbols:  # it may be there for another processor
                self._symbols.add(code.symbol)
                self._engine.add_object_file(binding.ObjectFileRef.from_data(code.code))
        self._engine.finalize_object()
        return True

    def _function(self, wrapper: Code, variables: dict[str, Any]) -> Callable[..., Any]:
        """Return a function that Python can call."""
        functions = _extension("numba._dynfunc")
        name, constants = pickle.loads(wrapper.rest)
        environment = functions.Environment(variables)
        environment.consts.extend(constants)
        place = ctypes.c_void_p.from_address(self._engine.get_global_value_address(name))
        place.value = id(environment)
        address = self._engine.get_function_address(wrapper.symbol)
        made = functions.make_function(
            sys.modules[__name__], wrapper.symbol, "", address, environment, (self, environment)
        )
        return cast(Callable[..., Any], made)

    @cached_property
    def _engine(self) -> Any:
        """LLVM's loader of object files, with the functions to which they refer."""
        _add_functions()
        binding.initialize_native_target()
        binding.initialize_native_asmprinter()
        target = binding.Target.from_triple(binding.get_process_triple())
        # As numba compiles: x86 has no relocation of code that is loaded into memory.
        static = binding.Target.from_default_triple().name.startswith("x86")
        machine = target.create_target_machine(
            reloc="static" if static else "default", codemodel="jitdefault", jit=True
        )
        return binding.create_mcjit_compiler(binding.parse_assembly(""), machine)


def _add_functions() -> None:
    """Make known to LLVM what compiled code calls: functions of numba, C and Python."""
    helpers = _extension("numba._helperlib").c_helpers
    for name, address in (*helpers.items(), *_extension("numba._dynfunc").c_helpers.items()):
        binding.add_symbol(f"numba_{name}", address)
    for name, address in helpers.items():
        # Of the C functions all are of one library: numba brings it along.
        if hasattr(math, name) or hasattr(math, name.removesuffix("f")):
            binding.add_symbol(name, address)
    binding.add_symbol("numba_unpickle", ctypes.cast(_unpickle, ctypes.c_void_p).value)
    for name, address in _extension("numba.core.runtime._nrt_python").c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
    binding.add_symbol("_Py_NoneStruct", id(None))
    for name, value in vars(builtins).items():
        if isinstance(value, type) and issubclass(value, BaseException):
            binding.add_symbol(f"PyExc_{name}", id(value))


def _constant(address: int, size: int, digest: int) -> Any:
    """Return a Python object that compiled code contains, such as the class of a named tuple.

    numba's function for this imports numba.

    Args:
        address: place of the pickled object.
        size: its length in bytes.
        digest: place of a digest, which is not needed: code stays where it is.
    """
    return _object(address, size)


@cache
def _object(address: int, size: int) -> Any:
    return pickle.loads(ctypes.string_at(address, size))


_unpickle = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)(
    _constant
)
loader = Loader()


def first_entry(files: Iterable[str], variables: dict[str, Any]) -> Callable[..., Any] | None:
    """Return the function of the first file that can be loaded (:meth:`Loader.entry`)."""
    entries = (loader.entry(file, variables) for file in files)
    return next((entry for entry in entries if entry is not None), None)
