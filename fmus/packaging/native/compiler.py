"""C compilers: the one of this machine, and ziglang's (an optional extra) for other platforms."""

from __future__ import annotations

import importlib.util
import logging
import os
import platform
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache as once
from importlib.metadata import version
from pathlib import Path

from fmus.errors import ModelError
from fmus.packaging import cache
from fmus.packaging.fingerprint import fingerprint

_MACH_PROCESSORS = {"x86_64-darwin": (0x01000007, 3), "aarch64-darwin": (0x0100000C, 0)}  # type and subtype
LOG = logging.getLogger("servotwin.compiler")
FLAGS = ("-std=c99", "-O2", "-fno-fast-math", "-ffp-contract=off", "-fvisibility=hidden", "-shared", "-s")
_ENVIRONMENT = ("CPATH", "C_INCLUDE_PATH", "LIBRARY_PATH", "COMPILER_PATH", "GCC_EXEC_PREFIX", "SDKROOT")
TIME_LIMIT = 600.0  # seconds; the first use of a cross target builds its C runtime


@dataclass(frozen=True)
class Platform:
    """A machine that FMUs run on.

    Attributes:
        name: FMI 3.0's name, and the folder of its binaries there.
        folder2: folder of its binaries in FMI 2.0.
        zig: ziglang's name of it; old versions of glibc make Linux binaries run on old systems.
    """

    name: str
    folder2: str
    suffix: str
    zig: str


PLATFORMS = {
    machine.name: machine
    for machine in (
        Platform("x86_64-linux", "linux64", ".so", "x86_64-linux-gnu.2.17"),
        Platform("aarch64-linux", "aarch64-linux", ".so", "aarch64-linux-gnu.2.17"),
        Platform("x86_64-windows", "win64", ".dll", "x86_64-windows-gnu"),
        Platform("x86_64-darwin", "darwin64", ".dylib", "x86_64-macos"),
        Platform("aarch64-darwin", "darwin64", ".dylib", "aarch64-macos"),
    )
}


def host() -> Platform:
    """This machine's platform.

    Raises:
        ModelError: it is none that native FMUs are built for.
    """
    name = host_name()
    if name not in PLATFORMS:
        raise ModelError(f"platform {name}", "native FMUs are not built for it", "build it as --target python")
    return PLATFORMS[name]


def host_name() -> str:
    """FMI 3.0's name of this machine's platform, whether native FMUs are built for it or not."""
    system = {"linux": "linux", "win32": "windows", "darwin": "darwin"}.get(sys.platform, sys.platform)
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    return f"{machine}-{system}"


def available() -> bool:
    """Whether there is a compiler for this machine."""
    try:
        return bool(command_for(host()))
    except ModelError:
        return False


def find(names: Sequence[str]) -> tuple[Platform, ...]:
    """The platforms of these names; "host" is this machine, "all" are all.

    Raises:
        ModelError: a name that is no platform.
    """
    chosen: dict[str, Platform] = {}
    for name in names:
        if name not in (*PLATFORMS, "host", "all"):
            raise ModelError(f"platform '{name}'", "is not known", f"choose host, all, {', '.join(PLATFORMS)}")
        picked = PLATFORMS.values() if name == "all" else [host() if name == "host" else PLATFORMS[name]]
        chosen |= {machine.name: machine for machine in picked}
    return tuple(chosen.values())


def command_for(target: Platform) -> tuple[str, ...]:
    """The compiler's command for a platform, without files and flags: $CC, cc, gcc or clang here, else ziglang's.

    Raises:
        ModelError: there is none.
    """
    if target == host():
        given = tuple(shlex.split(os.environ.get("CC", "")))
        for candidate in [given] if given else [("cc",), ("gcc",), ("clang",)]:
            if shutil.which(candidate[0]):
                return candidate
        if given:
            raise ModelError("CC", f"names '{given[0]}', which is not found", "correct the variable or unset it")
    if importlib.util.find_spec("ziglang") is None:
        here = "no C compiler found" if target == host() else f"no compiler for {target.name}"
        raise ModelError(f"platform {target.name}", here, "pip install 'servotwin[cross]', or build for the host")
    return (sys.executable, "-m", "ziglang", "cc", "-target", target.zig)


def compile_library(sources: Mapping[str, str], name: str, target: Platform, flags: Sequence[str] = ()) -> bytes:
    """The shared library made of these sources (file name -> text); the same sources are compiled once a process.

    Args:
        name: of the model; the library becomes `<name>.so` or the like.
        flags: for the compiler, beside those that every model is compiled with.

    Raises:
        ModelError: no compiler, or it failed; its first message is told.
    """
    command = (*command_for(target), *FLAGS, *flags)
    return _kept(tuple(sorted(sources.items())), name, target, command, fingerprint(identity(target)))


@once
def _kept(
    sources: tuple[tuple[str, str], ...], name: str, target: Platform, command: tuple[str, ...], compiler: str
) -> bytes:
    """The library from the cache, compiled where it is not there."""
    kept = cache.current()
    if kept is None:
        return _compiled(sources, name, target, command)
    key = fingerprint("library", sources, name, target.name, command, compiler)
    library = kept.get(key)
    if library is None:
        library = _compiled(sources, name, target, command)
        kept.put(key, library)
    return library


def identity(target: Platform) -> tuple[object, ...]:
    """What tells the compiler of a platform from others: its command, its programs' files, what else it looks at.

    A program's size and date stand for its version: it is not run for this.
    """
    command = command_for(target)
    programs = [Path(found).resolve() for word in command if (found := shutil.which(word)) is not None]
    files = [(str(program), program.stat().st_size, program.stat().st_mtime_ns) for program in programs]
    package = version("ziglang") if "ziglang" in command else ""
    return command, FLAGS, files, package, _c_library(), [(name, os.environ.get(name)) for name in _ENVIRONMENT]


def _c_library() -> str:
    """Name and version of the C library where it tells them."""
    if sys.platform == "linux" and "CS_GNU_LIBC_VERSION" in os.confstr_names:  # musl has none
        return os.confstr("CS_GNU_LIBC_VERSION") or ""
    return ""


def _compiled(sources: tuple[tuple[str, str], ...], name: str, target: Platform, compiler: tuple[str, ...]) -> bytes:
    library = name + target.suffix
    units = [file for file, _ in sources if file.endswith(".c")]
    command = [*compiler, *position(target), "-o", library, *units, *libraries(target)]
    with tempfile.TemporaryDirectory(prefix="servotwin-cc-") as folder:
        for file, text in sources:
            (Path(folder) / file).write_text(text)
        LOG.info("in %s: %s", folder, shlex.join(command))
        run(command, folder, f"model {name}, {target.name}")
        return (Path(folder) / library).read_bytes()


def universal(parts: Mapping[str, bytes]) -> bytes:
    """One Mach-O file of those of several processors: platform name -> library."""
    page = 1 << 14
    head, bodies, offset = struct.pack(">II", 0xCAFEBABE, len(parts)), b"", page
    for name, library in parts.items():
        head += struct.pack(">5I", *_MACH_PROCESSORS[name], offset, len(library), 14)
        padded = library + bytes(-len(library) % page)
        bodies += padded
        offset += len(padded)
    return head.ljust(page, b"\0") + bodies


def position(target: Platform) -> list[str]:
    """Flags for code that may lie anywhere in memory."""
    return [] if target.suffix == ".dll" else ["-fPIC"]


def libraries(target: Platform) -> list[str]:
    """Flags for the libraries that FMUs need: of mathematics, and with FMUs inside of loading those."""
    return ["-Wl,--as-needed", "-lm", "-ldl"] if target.suffix == ".so" else []


def run(command: Sequence[str], folder: str, place: str) -> None:
    """Have a compiler do its work in a folder.

    Raises:
        ModelError: it cannot be run, or failed; its first message is told.
    """
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, errors="replace", timeout=TIME_LIMIT, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ModelError(place, f"'{command[0]}' cannot be run ({error})", "check the compiler") from error
    LOG.debug("%s", done.stderr)
    if done.returncode:
        raise ModelError(place, f"'{command[0]}' failed: {_first_problem(done.stderr)}", "see its command with -v")


def _first_problem(text: str) -> str:
    """The line of a compiler's output that tells most."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line.lower()]
    return (errors or lines or ["it gave no reason"])[0][:300]
