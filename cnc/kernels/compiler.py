"""Compilation of kernels by numba, to files of code.

numba puts the code of all kernels that a kernel calls into its own code, and optimises all of it
again. Most of the time of a compilation went into that. Here a kernel contains only the small
kernels that it calls, which LLVM would inline. It refers to the others by name:

    pulses ---calls---> half_step_rows ---calls---> curve_eval       three files of compiled code
       '--contains---> rests                                         inside the file of pulses

A file lists the files that its code refers to (:mod:`cnc.kernels.loader`). So the names of
compiled functions must be the same in all processes: numba's count of compilations, which it puts
into them, is left out.

A kernel that Python calls needs a function that converts the arguments. It is made, and kept,
apart, and only for kernels that are called so.

Nothing that is compiled here runs before it has been loaded from its file. numba would also
generate machine code for each of its own functions that a kernel contains; that is left out.

numba's documented interface has no means for this, so the classes here derive from its compiler
(0.68): a change of numba's version needs a run of the tests in ``tests/kernels``.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from functools import cached_property
from typing import Any, NamedTuple
from unittest.mock import patch

from llvmlite import binding
from numba.core.caching import NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, CompileResult, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.lowering import Environment
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys
from numba.core.serialize import dumps
from numba.core.typed_passes import InlineOverloads
from numba.core.types import unliteral  # type: ignore[attr-defined]
from numba.core.untyped_passes import InlineClosureLikes

from cnc.kernels import code_cache, loader
from cnc.kernels.compiler_work import repeated_work_left_out
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

LEFT_OUT = InlineClosureLikes, InlineOverloads
"""Passes of numba that kernels do not need: they have no functions or comprehensions inside."""

Types = tuple[Any, ...]
watchers: list[Callable[[Kernel], None]] = []
"""Functions that are called before a kernel is compiled."""


class Callee(NamedTuple):
    """A kernel for one set of argument types, to which compiled code refers."""

    module: str
    name: str
    arguments: Types


class InnerLibrary(JITCodeLibrary):  # type: ignore[misc]
    """A function of numba that kernels contain, which are optimised and compiled as a whole."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: it is never called by itself."""
        return 0


class KernelLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The compiled code of one kernel.

    Attributes:
        kernel: the kernel and its argument types.
        symbol: name of its function.
        callees: kernels to which the code refers, in the order of their calls.
        code: the machine code, an object file.
    """

    def __init__(self, codegen: Any, kernel: Callee) -> None:
        super().__init__(codegen, kernel.name)
        self.kernel = kernel
        self.symbol, self.code = "", b""
        self.callees: dict[Callee, None] = {}
        self._bitcode = b""
        self._linking_libraries: list[Any] = []
        self._shared_module: Any = None

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

    def _finalize_final_module(self) -> None:
        self._verify_declare_only_symbols()
        self.code = self._codegen._tm.emit_object(self._final_module)
        self._finalized = True

    @cached_property
    def is_small(self) -> bool:
        """Whether callers contain this code."""
        function = super()._get_module_for_linking().get_function(self.symbol)
        return str(function).count("\n") <= INLINED

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None and self._bitcode:
            self._shared_module = binding.parse_bitcode(self._bitcode)
        return super()._get_module_for_linking()

    def bitcode(self) -> bytes:
        """Return the code that callers contain; nothing if they do not contain this kernel."""
        return self._get_module_for_linking().as_bitcode() if self.is_small else b""

    @classmethod
    def restored(
        cls, codegen: Any, kernel: Callee, callees: list[Callee], symbol: str, bitcode: bytes
    ) -> KernelLibrary:
        """Return code that is on disk. The kernels that it calls are compiled if need be."""
        for callee in callees:
            kernels[callee.module, callee.name].dispatcher.compile(callee.arguments)
        self = cls(codegen, kernel)
        self.symbol, self.callees = symbol, dict.fromkeys(callees)
        self.is_small, self._bitcode = bool(bitcode), bitcode
        self._finalized = True
        return self


class KernelCompiler(CompilerBase):  # type: ignore[misc]
    """numba's compiler, with :class:`KernelLibrary` and names without a count."""

    def define_pipelines(self) -> list[Any]:
        """Return numba's passes, without those that look for functions inside of functions."""
        state = self.state
        state.flags.no_compile = True  # the machine code is not loaded, but written to a file
        function = state.func_id
        function.unique_id, function.unique_name = 0, function.func_qualname
        kernel = Callee(function.modname, function.func_qualname, tuple(state.args))
        state.library = KernelLibrary(state.targetctx.codegen(), kernel)
        passes = DefaultPassBuilder.define_nopython_pipeline(state)
        passes.passes = [each for each in passes.passes if each[0] not in LEFT_OUT]
        passes.finalize()
        return [passes]


@contextmanager
def _no_inner_code(codegen: Any) -> Iterator[None]:
    """Do not generate machine code for numba's own functions, which kernels contain."""
    with (
        patch.object(codegen, "_library_class", InnerLibrary),
        patch.object(codegen, "set_env", lambda name, environment: None),
    ):
        yield


class KernelDispatcher(CPUDispatcher):  # type: ignore[misc]
    """Compiles a kernel, for Python and for the kernels that call it."""

    def __init__(self, kernel: Kernel) -> None:
        super().__init__(kernel.py_func, targetoptions=OPTIONS, pipeline_class=KernelCompiler)
        self._releases_gil = kernel.releases_gil
        self._kernel = kernel
        self._cache = NullCache()
        self._files: dict[Types, str] = {}

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return the type of a call by another kernel.

        A constant has a type of its own, for which numba would compile the called kernel once more.
        Here it has the type of its value.
        """
        return super().get_call_template(tuple(map(unliteral, args)), kws)

    def compile(self, sig: Any) -> Any:
        """Compile the kernel for these types, unless there is a file of its code.

        Returns:
            numba's key for the function, for calls by other kernels.
        """
        arguments = tuple(sig)
        with global_compiler_lock:
            if not self._is_known(arguments):
                with code_cache.locked(f"{self._kernel.label} {arguments}"):
                    if not self._is_known(arguments):  # another process may have compiled it
                        self._compile(arguments)
        return self.overloads[arguments].entry_point

    def _compile(self, arguments: Types) -> None:
        for watcher in watchers:
            watcher(self._kernel)
        rtsys.initialize(self.targetctx)
        codegen = self.targetctx.codegen()
        with _no_inner_code(codegen), repeated_work_left_out():
            super().compile(arguments)
            result = self.overloads[arguments]
            result.library.finalize()
        library, descriptor = result.library, result.fndesc
        descriptor.typemap = descriptor.calltypes = None
        needs = [_file(callee) for callee in library.callees]
        state = library.kernel, list(library.callees), library.bitcode(), descriptor
        code = loader.Code(library.symbol, needs, library.code, dumps((*state, result.signature)))
        loader.keep(self._kept(arguments), code)

    def _paths(self, arguments: Types) -> list[str]:
        """Return the files in which code for these types may be."""
        folder = self._kernel.folder
        return loader.file_names(folder, self._kernel.name, str(arguments), ".code")

    def _kept(self, arguments: Types) -> str:
        """Return the file to write; it is that of the code for these types from now on."""
        self._files[arguments] = self._paths(arguments)[-1]
        return self._files[arguments]

    def file(self, arguments: Types) -> str:
        """Return the file of compiled code for these types."""
        return self._files[arguments]

    def _is_known(self, arguments: Types) -> bool:
        """Return whether there is code for these types; read the file if it is not known yet."""
        if arguments in self.overloads:
            return True
        for file in self._paths(arguments):
            code = loader.read(file)
            if code is not None:
                try:
                    self._restore(code)
                except (AttributeError, ImportError, LookupError):
                    continue  # it refers to something that this installation does not have
                self._files[arguments] = file
                return True
        return False

    def _restore(self, code: loader.Code) -> None:
        """Make code of a file known to numba.

        Raises:
            LookupError: If it needs a file that is missing, and has another name when it is made.
        """
        kernel, callees, bitcode, descriptor, signature = pickle.loads(code.rest)
        library = KernelLibrary.restored(
            self.targetctx.codegen(), kernel, callees, code.symbol, bitcode
        )
        if code.needs != [_file(callee) for callee in callees]:
            raise LookupError
        result = CompileResult(
            target_context=self.targetctx,
            typing_context=self.targetctx.typing_context,
            library=library,
            environment=None,
            entry_point=None,
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
        self.add_overload(result)

    def add_overload(self, cres: Any) -> None:
        """Make compiled code known to the kernels that call it."""
        entry = object()  # numba's key for the function; nothing calls it here
        cres.library.symbol = cres.fndesc.llvm_func_name
        self.targetctx.insert_user_function(entry, cres.fndesc, [cres.library])
        self.overloads[tuple(cres.signature.args)] = cres._replace(entry_point=entry)

    def wrap(self, values: tuple[Any, ...], file: str) -> None:
        """Make the function by which Python calls the kernel with values of these types.

        Args:
            values: the arguments.
            file: the file to write.
        """
        arguments = tuple(unliteral(self.typeof_pyval(each)) for each in values)
        with global_compiler_lock:
            self.compile(arguments)
            with code_cache.locked(file):
                if loader.read(file) is None:
                    loader.keep(file, self._wrapper(arguments))

    def _wrapper(self, arguments: Types) -> loader.Code:
        result, context = self.overloads[arguments], self.targetctx.subtarget(enable_nrt=True)
        context.refresh()
        rtsys.initialize(context)
        library = KernelLibrary(context.codegen(), result.library.kernel)
        library.callees = {result.library.kernel: None}
        library.add_linking_library(rtsys.library)
        descriptor = copy(result.fndesc)
        descriptor.env_name += ".wrapper"
        environment = Environment.from_fndesc(descriptor)
        with context.push_code_library(library):
            context.create_cpython_wrapper(
                library, descriptor, environment, None, release_gil=self._releases_gil
            )
        library.finalize()
        rest = dumps((descriptor.env_name, environment.consts))
        needs = [self._files[arguments]]
        return loader.Code(descriptor.llvm_cpython_wrapper_name, needs, library.code, rest)


def _file(callee: Callee) -> str:
    """Return the file of the compiled code of a kernel."""
    return str(kernels[callee.module, callee.name].dispatcher.file(callee.arguments))
