"""Machine code of one kernel: what it contains, what it refers to, how it is optimised.

numba optimises each function alone, then all that a library contains cheaply, then all of it with
effort. Here the functions are optimised with the library that contains them. The cheap step, which
brings counts of references together that cancel each other, is for kernels that count.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.runtime import rtsys

from cnc.compiled.kernel import kernels
from cnc.compiled.values import leave_out_unused

INLINED = 100
"""Lines of a function in LLVM's language, and arguments of its calls, up to which callers contain
it. LLVM inlines functions of up to about 50 instructions, and more if they have many arguments.
"""

NO_COUNT = """
define linkonce_odr void @NRT_incref(ptr %0) alwaysinline nounwind { ret void }
define linkonce_odr void @NRT_decref(ptr %0) alwaysinline nounwind { ret void }
"""
"""Counting of references where none is needed, in LLVM's language."""
COUNTING = {"NRT_incref", "NRT_decref", "NRT_MemInfo_call_dtor", "NRT_Free"}
"""Functions of numba that make no array. The third frees one, the last the text of an error."""

Types = tuple[Any, ...]


class Callee(NamedTuple):
    """A kernel for one set of argument types, to which compiled code refers."""

    module: str
    name: str
    arguments: Types


class LeanLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code without values that nothing uses. Functions are not optimised by themselves."""

    def add_ir_module(self, module: Any) -> None:
        """Add code of a function."""
        leave_out_unused(module)
        super().add_ir_module(module)

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout


class InnerLibrary(LeanLibrary):
    """A function of numba that kernels contain, which are optimised and compiled as a whole."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: it is never called by itself."""
        return 0


class KernelLibrary(LeanLibrary):
    """The compiled code of one kernel.

    Attributes:
        kernel: the kernel and its argument types.
        symbol: name of its function.
        callees: kernels to which the code refers, in the order of their calls.
        code: the machine code, an object file.
        returns_arrays: whether its caller takes over references to arrays.
        counts_references: whether references to arrays are counted: in what is generated, and
            afterwards in the whole code.
    """

    def __init__(self, codegen: Any, kernel: Callee) -> None:
        super().__init__(codegen, kernel.name)
        self.counts_references = True
        self.kernel = kernel
        self.symbol, self.code = "", b""
        self.returns_arrays = False
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
        self.counts_references = not self._only_borrows()
        if not self.counts_references:
            # The first definition of a function counts.
            self._final_module.link_in(binding.parse_assembly(NO_COUNT), preserve=True)
        super().finalize()

    def _only_borrows(self) -> bool:
        """Return whether the callers hold all arrays, so that no reference has to be counted."""
        if self.returns_arrays or any(
            kernels[each.module, each.name].dispatcher.returns_arrays(each.arguments)
            for each in self.callees
        ):
            return False
        linked = (
            library._get_module_for_linking()
            for library in self._linking_libraries
            if library is not rtsys.library
        )
        names = {each.name for module in (self._final_module, *linked) for each in module.functions}
        return not any(name.startswith("NRT_") for name in names - COUNTING)

    def _finalize_final_module(self) -> None:
        self._verify_declare_only_symbols()
        self.code = self._codegen._tm.emit_object(self._final_module)
        self._finalized = True

    @cached_property
    def is_small(self) -> bool:
        """Whether callers contain this code."""
        lines = str(self._final_module.get_function(self.symbol)).splitlines()
        # Machine code puts each argument of a call in place by an instruction.
        return len(lines) + sum(line.count(", ") for line in lines if " call " in line) <= INLINED

    def _optimize_final_module(self) -> None:
        """Optimise once, unless a first pass brings counts together that cancel each other."""
        if self.counts_references:
            super()._optimize_final_module()
        else:
            passes, builder = self._codegen._module_pass_manager()
            passes.run(self._final_module, builder)

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
