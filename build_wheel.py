"""Add compiled kernels and the tables of the grammars to a wheel, if ``CNC_COMPILED`` says where.

The wheel is then for one system and one version of Python (``make wheel``). Without it the wheel is
for all.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

LINUX = "manylinux_2_28"
"""The compiled kernels call no library by itself, so the systems are those of numba's wheels."""


class CompiledKernels(BuildHookInterface):  # type: ignore[type-arg, misc]
    """Adds a folder of compiled kernels, and the tables of the grammars."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the files, and name system and version of Python."""
        folder = os.environ.get("CNC_COMPILED")
        if not folder or version == "editable":
            return
        python = f"cp{sys.version_info.major}{sys.version_info.minor}"
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        system = platform.replace("linux", LINUX, 1)
        build_data["pure_python"] = False
        build_data["tag"] = f"{python}-{python}{sys.abiflags if os.name != 'nt' else ''}-{system}"
        build_data["force_include"][folder] = "cnc/compiled/code"
        for file in write_tables(Path(folder).parent / "tables"):
            build_data["force_include"][str(file)] = f"cnc/grammars/{file.name}"


def write_tables(folder: Path) -> list[Path]:
    """Write the tables of all grammars into a folder, and return their files."""
    sys.path.insert(0, str(Path(__file__).parent))
    from cnc.gcode.reader.tables import NAMES, write_named

    folder.mkdir(parents=True, exist_ok=True)
    return [write_named(name, folder) for name in NAMES]
