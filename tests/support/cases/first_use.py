"""A newcomer's own drive, recordings and mistakes."""

from __future__ import annotations

from tests.support.cases.case import Case, Step

# An FMU that misbehaves -> the exit codes that are right, and what must be named.
_HOSTILE: dict[str, tuple[tuple[int, ...], str]] = {
    "CTOR_SEGV": ((3,), "b_CTOR_SEGV"),
    "CTOR_EXIT": ((3,), "b_CTOR_EXIT"),
    "THREAD": ((0,), ""),
    "CHDIR": ((0,), ""),
    "SIGIGN": ((0,), ""),
    "CLOSEFDS": ((3,), "b_CLOSEFDS|wheel"),
    "FPE": ((0, 3), ""),
    "FREESEGV": ((0, 3), ""),
    "SEGV": ((3,), "--isolate"),
    "EXIT0": ((3,), "b_EXIT0|wheel"),
    "EXIT7": ((3,), "b_EXIT7|wheel"),
    "ABORT": ((3,), "--isolate"),
    "SPAM": ((0,), ""),
    "SPAMERR": ((0,), ""),
    "LOGSPAM": ((0, 3), ""),
    "LOGFMT": ((0, 3), ""),
    "STACK": ((0, 3), ""),
    "NANOUT": ((3,), r"wheel\.speed.*0\.5"),
    "HUGESTATUS": ((3,), "wheel"),
    "STDIN": ((0,), ""),
    "LOCALE": ((0,), ""),
}


def _hostile(kind: str) -> Case:
    codes, shows = _HOSTILE[kind]
    # A process that closes its output says nothing: the exit code is all there is.
    return Case(
        "first_use/hostile",
        [
            Step("test -f wheel.fmu || { servotwin build flywheel.py --out . && mv flywheel.fmu wheel.fmu; }"),
            Step(f"test -f b_{kind}.fmu || python mkbad.py"),
            Step(f"rm -rf out; servotwin run b_{kind}.yaml --out out", codes, [shows] if shows else ()),
            Step(f"rm -rf out; servotwin run b_{kind}.yaml --isolate --patience 5 --out out", codes),
        ],
    )


def _layout(name: str, file: str, shows: tuple[str, ...] = ()) -> Case:
    """A recording that is understood, and the block that says how."""
    return Case(
        f"first_use/recordings/{name}",
        [
            Step(f"servotwin trace info {file}", 0, ("layout:", *shows)),
            Step(f"servotwin trace convert {file} out.parquet"),
        ],
    )


def _study(name: str, data: str) -> Case:
    """A study of recordings as they are: read rightly, or refused with the key that mends it."""
    return Case(
        "first_use",
        [
            Step(
                f"servotwin calibrate studies/{name}.yaml --data recordings/{data} --out out/{name}",
                (0, 1, 2),
                (),
                ["Error:"],
            )
        ],
    )


def _wrong(name: str, *shows: str) -> Case:
    return Case(
        "first_use/models_wrong", [Step(f"servotwin build {name}.py --out out", 2, (rf"{name}\.py", *shows), ["sympy"])]
    )


CASES = {
    "first_use/plain": Case(
        "first_use",
        [
            Step(
                "servotwin calibrate studies/plain.yaml --data plain --out out/plain; code=$?; "
                "cat out/plain/summary.json; exit $code",
                (0, 1),
                ["rpm to rad/s", "deg to rad"],
                [r"median FIT[^\n]*: -"],
            )
        ],
    ),
    "first_use/drive": Case("first_use", [Step("servotwin run drive.yaml --out out/drive", 0, (), ["FAILED"])]),
    "first_use/drive_mnm": Case("first_use", [Step("servotwin run drive_mnm.yaml --out out/mnm", 0)]),
    "first_use/nonfin": Case(
        "first_use/hostile",
        [
            Step("cp ../nonfin.yaml .; rm -rf out; servotwin run nonfin.yaml --out out", 2, ["inertia"]),
            Step("test ! -e out"),
        ],
    ),
    "first_use/z_huge": Case(
        "first_use/hostile", [Step("cp ../z_huge.yaml .; servotwin run z_huge.yaml --out out", 2, ["rows"])]
    ),
    "first_use/ctl": Case("first_use", [Step("servotwin trace info ctl.csv", None, (), ["[\\x07\\x1b]"])]),
    "first_use/api_calibrate": Case(
        "first_use",
        [
            Step(
                "printf '%s\\n' 'from identification import calibrate' "
                '\'print("DONE", calibrate("studies/init.yaml", data="plain").parameters)\' > api.py; '
                "timeout 250 python api.py",
                0,
                ["DONE"],
            )
        ],
    ),
    "first_use/recordings german": _layout("german", "chirp.csv", ("decimal",)),
    "first_use/recordings excel": _layout("excel", "chirp.csv"),
    "first_use/recordings ms": _layout("ms", "chirp.csv", ("ms|milli|0.001",)),
    **{
        f"first_use/recordings {file}": _layout("labels", file)
        for file in (
            "chirp.tdms",
            "chirp_pandas.csv",
            "chirp_idx.csv",
            "chirp_v5.mat",
            "chirp_v73.mat",
            "chirp.xlsx",
            "chirp.tsv",
            "nan.csv",
        )
    },
    **{f"first_use/recordings {file}": _layout("parquet", file) for file in ("chirp.parquet", "chirp_index.parquet")},
    "first_use/study excel": _study("lay_excel", "excel"),
    "first_use/study german": _study("lay_german", "german"),
    "first_use/study ms": _study("lay_ms", "ms"),
    "first_use/models_wrong iff": _wrong("iff", r"\b10\b", "ops.where"),
    "first_use/models_wrong missder": _wrong("missder", "motor_angle|load_angle"),
    "first_use/models_wrong syntax": _wrong("syntax", r"\b18\b"),
    "first_use/models_wrong timeout_div": _wrong("timeout_div", ":36"),
    "first_use/models_wrong typo": _wrong("typo", r"\b8\b", "motor_angel"),
    "first_use/models_wrong unit": _wrong("unit", "unit"),
    **{f"first_use/hostile {kind}": _hostile(kind) for kind in _HOSTILE},
}
