"""What setuptools cannot be told in pyproject.toml: the compiled stepping loop, and archives of sources that are equal.

The loop is built where there is a C compiler and left out where there is none. A source archive has the same bytes
wherever and whenever it is made of the same files: sorted, nobody's, and dated SOURCE_DATE_EPOCH (else 1980).
"""

import gzip
import os
import tarfile
from pathlib import Path

from Cython.Build import cythonize
from setuptools import Extension, setup
from setuptools.command.sdist import sdist

# A fused multiply-add would round differently from Python.
FLAGS = [] if os.name == "nt" else ["-O3", "-g0", "-ffp-contract=off"]
ENGINE = Path("orchestrator/engine")
LOOP = Extension(
    "orchestrator.engine._compiled",
    [str(ENGINE / "_compiled.pyx")],
    depends=[str(part) for part in sorted((ENGINE / "c_loop").glob("*.pxi"))],
    extra_compile_args=FLAGS,
)
EARLIEST = 315532800  # what a zip archive can tell: 1980


class SameBytes(sdist):
    """`sdist` whose archive depends on the files' names and contents alone."""

    def make_archive(self, base_name, format, root_dir=None, base_dir=None, owner=None, group=None):
        if format != "gztar":
            return super().make_archive(base_name, format, root_dir, base_dir, owner, group)
        date = int(os.environ.get("SOURCE_DATE_EPOCH", EARLIEST))

        def plain(member: tarfile.TarInfo) -> tarfile.TarInfo:
            member.mtime, member.uid, member.gid, member.uname, member.gname = date, 0, 0, "", ""
            member.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            return member

        root = Path(root_dir or ".")
        target = Path(f"{base_name}.tar.gz")
        with (
            target.open("wb") as file,
            gzip.GzipFile(filename="", mode="wb", fileobj=file, mtime=date) as packed,
            tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as archive,
        ):
            for path in sorted((root / base_dir).rglob("*")):
                archive.add(path, path.relative_to(root), recursive=False, filter=plain)
        return str(target)


extensions = cythonize([LOOP], build_dir="build/cython", quiet=True)
for extension in extensions:
    extension.optional = True

setup(ext_modules=extensions, cmdclass={"sdist": SameBytes})
