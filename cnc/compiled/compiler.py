"""Compilation of kernels by numba, to files of code.

numba puts the code of all kernels that a kernel calls into its own code, and optimises all of it
again. Most of the time of a compilation went into that. Here a kernel contains only the small
kernels that it calls, which LLVM would inline. It refers to the others by name:

    pulses ---calls---> half_step_rows ---calls---> curve_eval       three files of compiled code
       '--contains---> rests                                         inside the file of pulses

A file lists the files that its code refers to (:mod:`cnc.compiled.loader`). So the names of
compiled functions must be the same in all processes. Two counts that numba puts into them are left
out: that of compilations, and that of types of records.

A kernel that Python calls needs a function that converts the arguments. It is made, and kept,
apart, and only for kernels that are called so.

numba counts the references to arrays wherever one is passed or indexed. An array that comes from
the arguments of a kernel needs no count, unless it is returned: the caller holds it. There the
counting is left out (:mod:`cnc.compiled.borrowing`).

Most of the code that numba generates moves values about. Arguments are passed in a shorter way
(:mod:`cnc.compiled.kernel_arguments`), and detours are left out (:mod:`cnc.compiled.lean_code`).

Nothing that is compiled here runs before it has been loaded from its file. numba would also
generate machine code for each of its own functions that a kernel contains, and a function by which
C calls it; that is left out.

numba's documented interface has no means for this, so the classes here derive from its compiler
(0.68): a change of numba's version needs a run of the tests in ``tests/kernels``.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from copy import copy
from typing import Any
from unittest.mock import patch

from numba.core.caching import NullCache
from numba.core.compiler import CompilerBase, CompileResult, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.cpu import CPUContext
from numba.core.lowering import Environment
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys
from numba.core.runtime.context import NRTContext
from numba.core.serialize import dumps
from numba.core.typed_passes import InlineOverloads, NativeLowering, NopythonRewrites
from numba.core.types import Record, unliteral  # type: ignore[attr-defined]
from numba.core.untyped_passes import InlineClosureLikes

from cnc.compiled import code_cache, loader
from cnc.compiled.borrowing import ArrayRewrites, count_where_needed
from cnc.compiled.code_library import Callee, InnerLibrary, KernelLibrary, Types
from cnc.compiled.compiler_work import repeated_work_left_out
from cnc.compiled.frames import with_room
from cnc.compiled.kernel import Kernel, kernels, watchers
from cnc.compiled.kernel_arguments import passed_briefly
from cnc.compiled.lean_code import KernelLowering, detours_left_out

OPTIONS = {
    "nopython": True,
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}

LEFT_OUT = InlineClosureLikes, InlineOverloads
"""Passes of numba that kernels do not need: they have no functions or comprehensions inside."""
REPLACED = {NopythonRewrites: ArrayRewrites, NativeLowering: KernelLowering}
"""Passes of numba, and those that take their place."""


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
        passes.passes = [
            (REPLACED.get(each, each), text) for each, text in passes.passes if each not in LEFT_OUT
        ]
        passes.finalize()
        return [passes]


@contextmanager
def _no_inner_code(codegen: Any) -> Iterator[None]:
    """Do not generate machine code for numba's own functions, which kernels contain."""
    with (
        patch.object(codegen, "_library_class", InnerLibrary),
        patch.object(codegen, "set_env", lambda name, environment: None),
        patch.object(CPUContext, "create_cfunc_wrapper", lambda *parts: None),
        patch.object(NRTContext, "_call_incref_decref", count_where_needed),
        patch.object(Record, "mangling_args", property(_record_name)),
    ):
        yield


def _record_name(record: Any) -> tuple[str, tuple[str]]:
    """Return the parts of a symbol for a type of records: its fields instead of numba's count."""
    return "Record", (hashlib.sha256(str(record).encode()).hexdigest()[:16],)


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
        with (
            _no_inner_code(codegen),
            repeated_work_left_out(),
            detours_left_out(),
            passed_briefly(),
        ):
            super().compile(arguments)
            result = self.overloads[arguments]
            result.library.returns_arrays = self.returns_arrays(arguments)
            result.library.finalize()
        library, descriptor = result.library, result.fndesc
        descriptor.typemap = descriptor.calltypes = None
        needs = _needs(library.callees)
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

    def returns_arrays(self, arguments: Types) -> bool:
        """Return whether the value for these types contains arrays."""
        models = self.targetctx.data_model_manager
        model = models[self.overloads[arguments].signature.return_type]
        return bool(model.contains_nrt_meminfo())

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
            LookupError: If it needs a file that is missing, or a function that has another name.
        """
        kernel, callees, bitcode, descriptor, signature = pickle.loads(code.rest)
        library = KernelLibrary.restored(
            self.targetctx.codegen(), kernel, callees, code.symbol, bitcode
        )
        if code.needs != _needs(callees):
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

    @with_room
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
                code = loader.read(file)
                if code is None or code.needs != _needs([self._callee(arguments)]):
                    loader.keep(file, self._wrapper(arguments))

    def _callee(self, arguments: Types) -> Callee:
        callee: Callee = self.overloads[arguments].library.kernel
        return callee

    def _wrapper(self, arguments: Types) -> loader.Code:
        result, context = self.overloads[arguments], self.targetctx.subtarget(enable_nrt=True)
        context.refresh()
        rtsys.initialize(context)
        library = KernelLibrary(context.codegen(), result.library.kernel)
        library.callees = {result.library.kernel: None}
        library.returns_arrays = True  # as objects of Python
        library.add_linking_library(rtsys.library)
        descriptor = copy(result.fndesc)
        descriptor.env_name += ".wrapper"
        environment = Environment.from_fndesc(descriptor)
        with context.push_code_library(library), passed_briefly():
            context.create_cpython_wrapper(
                library, descriptor, environment, None, release_gil=self._releases_gil
            )
        library.finalize()
        rest = dumps((descriptor.env_name, environment.consts))
        needs = _needs(library.callees)
        return loader.Code(descriptor.llvm_cpython_wrapper_name, needs, library.code, rest)


def _needs(callees: Iterable[Callee]) -> dict[str, str]:
    """Return the symbols of some kernels by the files of their compiled code."""
    needs = {}
    for callee in callees:
        dispatcher = kernels[callee.module, callee.name].dispatcher
        symbol = dispatcher.overloads[callee.arguments].library.symbol
        needs[dispatcher.file(callee.arguments)] = symbol
    return needs
