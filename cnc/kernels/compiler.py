"""Compilation of kernels by numba, and their code on disk.

numba puts the code of all kernels that a kernel calls into its own code, and optimises all of it
again. Most of the time of a compilation went into that. Here a kernel contains only the small
kernels that it calls, which LLVM would inline. It refers to the others by name:

    pulses ---calls---> half_step_rows ---calls---> curve_eval       three files of compiled code
       '--contains---> rests                                         inside the file of pulses

A file lists the kernels that its code refers to. They are loaded before it. So the names of
compiled functions must be the same in all processes: numba's count of compilations, which it puts
into them, is left out.

A kernel that Python calls needs a function that converts the arguments. It is made, and kept,
apart, and only for kernels that are called so.

numba's documented interface has no means for this, so the classes here derive from its compiler
(0.68): a change of numba's version needs a run of the tests in ``tests/kernels``.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from copy import copy
from functools import cache, cached_property
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import numba
from llvmlite import binding
from numba.core.caching import _Cache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, CompileResult, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.lowering import Environment
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.core.types import unliteral  # type: ignore[attr-defined]

from cnc.kernels import code_cache
from cnc.kernels.jit import Kernel, kernels

INLINED = 100
"""Lines of a function in LLVM's language up to which callers contain it. LLVM inlines functions of
up to about 50 instructions, and some more if they have many arguments.
"""
OPTIONS = {
    "nopython": True,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}
PORTABLE = ("generic", "")
"""Name and features of the processor for which installed code was compiled."""

Types = tuple[Any, ...]
watchers: list[Callable[[Kernel], None]] = []
"""Functions that are called before a kernel is compiled."""


class Callee(NamedTuple):
    """A kernel for one set of argument types, to which compiled code refers."""

    module: str
    name: str
    arguments: Types


class KernelLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The compiled code of one kernel.

    Attributes:
        kernel: the kernel and its argument types.
        symbol: name of its function.
        callees: kernels to which the code refers, in the order of their calls.
    """

    def __init__(self, codegen: Any, kernel: Callee) -> None:
        super().__init__(codegen, kernel.name)
        self.kernel = kernel
        self.symbol = ""
        self.callees: dict[Callee, None] = {}
        self._bitcode = b""
        self._linking_libraries: list[Any] = []
        self._shared_module: Any = None
        self.enable_object_caching()

    def finalize(self) -> None:
        """Link the small kernels and numba's own functions, and compile."""
        linked: list[Any] = []
        for library in dict.fromkeys(self._linking_libraries):
            if isinstance(library, KernelLibrary):
                if library.is_small:
                    self.callees.update(library.callees)
                else:
                    self.callees[library.kernel] = None
                    continue
            linked.append(library)
        self._linking_libraries = linked
        super().finalize()

    @cached_property
    def is_small(self) -> bool:
        """Whether callers contain this code."""
        function = super()._get_module_for_linking().get_function(self.symbol)
        return str(function).count("\n") <= INLINED

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None and self._bitcode:
            self._shared_module = binding.parse_bitcode(self._bitcode)
        return super()._get_module_for_linking()

    def state(self) -> tuple[Any, ...]:
        """Return what :meth:`restored` needs."""
        bitcode = self._get_module_for_linking().as_bitcode() if self.is_small else b""
        return self.kernel, self.symbol, list(self.callees), self._get_compiled_object(), bitcode

    @classmethod
    def restored(cls, codegen: Any, state: tuple[Any, ...]) -> KernelLibrary:
        """Load the code of :meth:`state`, behind that of the kernels to which it refers."""
        kernel, symbol, callees, code, bitcode = state
        for callee in callees:
            kernels[callee.module, callee.name].dispatcher.compile(callee.arguments)
        self = cls(codegen, kernel)
        self.symbol, self.callees = symbol, dict.fromkeys(callees)
        self.is_small, self._bitcode = bool(bitcode), bitcode
        self._set_compiled_object(code)
        self._finalize_final_module()
        codegen._engine._defined_symbols.add(symbol)
        return self


class Wrapper(NamedTuple):
    """The function by which Python calls a kernel.

    Attributes:
        library: its code.
        descriptor: names of the kernel and its environment, from numba.
        environment: Python objects that the function uses, such as the classes of named tuples.
    """

    library: KernelLibrary
    descriptor: Any
    environment: Any


class KernelCompiler(CompilerBase):  # type: ignore[misc]
    """numba's compiler, with :class:`KernelLibrary` and names without a count."""

    def define_pipelines(self) -> list[Any]:
        """Return numba's passes."""
        state = self.state
        function = state.func_id
        function.unique_id, function.unique_name = 0, function.func_qualname
        kernel = Callee(function.modname, function.func_qualname, tuple(state.args))
        state.library = KernelLibrary(state.targetctx.codegen(), kernel)
        return [DefaultPassBuilder.define_nopython_pipeline(state)]


class KernelDispatcher(CPUDispatcher):  # type: ignore[misc]
    """Compiles, loads and calls a kernel."""

    def __init__(self, kernel: Kernel) -> None:
        super().__init__(kernel.py_func, targetoptions=OPTIONS, pipeline_class=KernelCompiler)
        self._kernel = kernel
        self._cache = KernelFiles(kernel)
        self._entries: list[Any] = []  # numba's C code refers to them, but does not keep them

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return the type of a call by another kernel.

        A constant has a type of its own, for which numba would compile the called kernel once more.
        Here it has the type of its value.
        """
        return super().get_call_template(tuple(map(unliteral, args)), kws)

    def compile(self, sig: Any) -> Any:
        """Compile the kernel for these types, or load it, for calls by other kernels."""
        arguments = tuple(sig)
        with global_compiler_lock:
            if arguments in self.overloads:
                return self.overloads[arguments].entry_point
            if self._load(arguments):
                return self.overloads[arguments].entry_point
            with code_cache.locked(f"{self._kernel.label} {arguments}"):
                if self._load(arguments):  # another process has compiled it meanwhile
                    return self.overloads[arguments].entry_point
                for watcher in watchers:
                    watcher(self._kernel)
                return super().compile(sig)

    def _load(self, arguments: Types) -> bool:
        """Load the code for these types, if there is some."""
        result = self._cache.load(arguments, self.targetctx)
        if result is None:
            return False
        self.targetctx.insert_user_function(result.entry_point, result.fndesc, [result.library])
        self.add_overload(result)
        return True

    def add_overload(self, cres: Any) -> None:
        """Keep compiled code; Python does not call it as it is."""
        cres.library.symbol = cres.fndesc.llvm_func_name
        self.overloads[tuple(cres.signature.args)] = cres

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        """Compile for a call by Python; numba's C code calls this for types that are new."""
        arguments = tuple(unliteral(self.typeof_pyval(each)) for each in args)
        with global_compiler_lock:
            self.compile(arguments)
            wrapper = self._cache.load_wrapper(arguments, self.targetctx) or self._wrap(arguments)
            entry = self.targetctx.get_executable(*wrapper)
            self._insert([each._code for each in arguments], entry, False)
            self._entries.append(entry)
        return entry

    def _wrap(self, arguments: Types) -> Wrapper:
        """Make the function that converts the arguments of a call by Python."""
        result, context = self.overloads[arguments], self.targetctx.subtarget(enable_nrt=True)
        context.refresh()
        library = KernelLibrary(context.codegen(), result.library.kernel)
        library.callees = {result.library.kernel: None}
        descriptor = copy(result.fndesc)
        descriptor.env_name += ".wrapper"
        environment = Environment.from_fndesc(descriptor)
        with context.push_code_library(library):
            context.create_cpython_wrapper(library, descriptor, environment, None)
        library.finalize()
        library.symbol, library.is_small = descriptor.llvm_cpython_wrapper_name, False
        wrapper = Wrapper(library, descriptor, environment)
        self._cache.save_wrapper(arguments, wrapper)
        return wrapper


@cache
def target() -> tuple[str, str, str]:
    """Return system, name and features of the processor for which kernels are compiled."""
    return CPUDispatcher.targetdescr.target_context.codegen().magic_tuple()


def version(processor: tuple[str, str] | None = None) -> tuple[str, ...]:
    """Return everything besides the kernels on which their code depends.

    Args:
        processor: name and features; by default those of this computer.
    """
    triple, *host = target()
    return triple, *(processor or host), numba.__version__, llvmlite.__version__


class KernelFiles(_Cache):  # type: ignore[misc]
    """Files of the compiled code of one kernel: one for each set of argument types.

    Installed code is looked up first, then code that was compiled on this computer.
    """

    def __init__(self, kernel: Kernel) -> None:
        self._folder, self._name = kernel.folder, kernel.name

    @property
    def cache_path(self) -> str:
        """Folder of the code that was compiled on this computer."""
        return str(code_cache.cache_folder() / (self._folder or ""))

    @cache  # noqa: B019 - dispatchers live as long as the process
    def _paths(self, arguments: Types) -> tuple[Path, ...]:
        """Return the files in which code may be, the first to look at first."""
        if self._folder is None:
            return ()
        paths = []
        for place, processor in ((code_cache.SHIPPED, PORTABLE), (code_cache.cache_folder(), None)):
            key = hashlib.sha256(repr((str(arguments), version(processor))).encode()).hexdigest()
            paths.append(place / self._folder / f"{self._name}-{key[:16]}.code")
        return tuple(paths)

    def _load(self, arguments: Types, suffix: str, rebuild: Callable[[Any], Any]) -> Any:
        """Return what ``rebuild`` makes of the first file that can be used; None for none."""
        for path in self._paths(arguments):
            code = code_cache.read(path.with_suffix(suffix))
            if code is not None:
                try:
                    return rebuild(pickle.loads(code))
                except (AttributeError, ImportError, KeyError):
                    continue  # it refers to something that this installation does not have
        return None

    def load_overload(self, sig: Any, target_context: Any) -> None:
        """Return nothing: numba asks when :meth:`load` has found nothing."""

    def load(self, arguments: Types, target_context: Any) -> Any:
        """Return compiled code; None if there is none.

        numba's own cache imports the whole compiler first, which is not needed to load code.
        """

        def rebuild(state: Any) -> Any:
            library, descriptor, signature = state
            loaded = KernelLibrary.restored(target_context.codegen(), library)
            environment = Environment.from_fndesc(descriptor)
            return CompileResult(
                target_context=target_context,
                typing_context=target_context.typing_context,
                library=loaded,
                environment=environment,
                entry_point=target_context.get_executable(loaded, descriptor, environment),
                fndesc=descriptor,
                type_annotation="",
                signature=signature,
                objectmode=False,
                lifted=(),
                typing_error=None,
                call_helper=None,
                metadata=None,
                reload_init=(),
                referenced_envs=(),
            )

        rtsys.initialize(target_context)
        return self._load(arguments, ".code", rebuild)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write compiled code.

        The Python objects that numba's own functions use for messages are left out. Kernels make no
        messages, and loading them takes longer than loading the code.
        """
        arguments, descriptor = tuple(sig), data.fndesc
        if self._folder is not None and not data.reload_init:
            descriptor.typemap = descriptor.calltypes = None
            state = data.library.state(), descriptor, data.signature
            code_cache.write(self._paths(arguments)[-1], dumps(state))

    def load_wrapper(self, arguments: Types, target_context: Any) -> Wrapper | None:
        """Return the function that converts arguments; None if there is none."""

        def rebuild(state: Any) -> Wrapper:
            library, descriptor, environment = state
            loaded = KernelLibrary.restored(target_context.codegen(), library)
            return Wrapper(loaded, descriptor, environment)

        return self._load(arguments, ".wrapper", rebuild)

    def save_wrapper(self, arguments: Types, wrapper: Wrapper) -> None:
        """Write the function that converts arguments."""
        if self._folder is not None:
            state = wrapper.library.state(), wrapper.descriptor, wrapper.environment
            path = self._paths(arguments)[-1].with_suffix(".wrapper")
            code_cache.write(path, dumps(state))

    def enable(self) -> None:
        """Do nothing: the cache is always in use."""

    def disable(self) -> None:
        """Do nothing: the cache is always in use."""

    def flush(self) -> None:
        """Do nothing: code of another text has another name."""
