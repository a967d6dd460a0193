"""The compiled stepping loop: built where there is a C compiler, left out where there is none."""

import os

from Cython.Build import cythonize
from setuptools import Extension, setup

# A fused multiply-add would round differently from Python.
FLAGS = [] if os.name == "nt" else ["-O3", "-g0", "-ffp-contract=off"]
LOOP = Extension("orchestrator.engine._compiled", ["orchestrator/engine/_compiled.pyx"], extra_compile_args=FLAGS)

extensions = cythonize([LOOP], build_dir="build/cython", quiet=True)
for extension in extensions:
    extension.optional = True

setup(ext_modules=extensions)
