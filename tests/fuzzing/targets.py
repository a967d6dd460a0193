"""What is fuzzed: how files of a kind are used, and sound ones to begin with."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fmus.packaging import archive, targets
from identification.study import load_study
from orchestrator import formats
from orchestrator.can import logs
from orchestrator.can.database.database import load as load_database
from orchestrator.info import about
from orchestrator.scenario.parameter_list import read as read_parameters
from orchestrator.scenario.schema import load_scenario
from orchestrator.ssp.checking import check
from orchestrator.trace import Trace
from tests.support.can.can_samples import DBC, any_frames
from tests.support.can.canopen_devices import EDS
from tests.support.can.text_logs import KINDS, text_of
from tests.support.simulation import ssps

ROOT = Path(__file__).parents[2]
XML = "modelDescription.xml"


@dataclass(frozen=True)
class Target:
    """A kind of file.

    Attributes:
        use: takes the file; whatever it holds, it returns or raises a ServotwinError.
        seeds: given a folder, sound files of the kind.
    """

    suffix: str
    use: Callable[[Path], object]
    seeds: Callable[[Path], Iterator[bytes]]


def _fmu(folder: Path) -> bytes:
    file = folder / "seed.fmu"
    targets.build("pendulum", file, target="python")
    small = {name: content for name, content in archive.read(file).items() if "/pythonfmu" not in name}
    archive.write(file, {name: b"" if name.startswith("binaries/") else held for name, held in small.items()})
    return file.read_bytes()


def _descriptions(folder: Path) -> Iterator[bytes]:
    for fmi in (2, 3):
        file = folder / f"seed{fmi}.fmu"
        targets.build("pendulum", file, fmi=fmi)
        yield archive.read(file)[XML]


def _describe(file: Path) -> object:
    """The file as the description of an FMU."""
    whole = file.with_suffix(".fmu")
    archive.write(whole, {XML: file.read_bytes(), "binaries/linux64/pendulum.so": b""})
    try:
        return about(whole)
    finally:
        whole.unlink(missing_ok=True)


SSP_FILES = {".ssd": "SystemStructure.ssd", ".ssv": "resources/values.ssv", ".ssm": "resources/names.ssm"}
NAMES = f"""<ssm:ParameterMapping {ssps.XMLNS} version="1.0"><ssm:MappingEntry source="gain" target="k"/>
<ssm:MappingEntry source="n" target="n"><ssc:IntegerMappingTransformation><ssc:MapEntry source="1" target="2"/>
</ssc:IntegerMappingTransformation></ssm:MappingEntry></ssm:ParameterMapping>"""


def _ssp_files() -> dict[str, str]:
    """The documents of a sound SSP: two gains in a row in a system within a system, values in three places."""
    bound = """<ssd:ParameterBindings><ssd:ParameterBinding source="resources/values.ssv">
    <ssd:ParameterMapping source="resources/names.ssm"/></ssd:ParameterBinding></ssd:ParameterBindings>"""
    inline = ssps.bindings(ssps.values({"b": ssps.real(2.0, "mm")}))
    unit = '<ssd:Units><ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit></ssd:Units>'
    linear = '<ssc:LinearTransformation factor="2" offset="1"/>'
    inner = ssps.system(
        [ssps.component("a", inner=bound), ssps.component("b", inner=inline, units=' unit="mm"')],
        [ssps.connection("a.y", "b.u", linear), ssps.connection("u", "a.u"), ssps.connection("b.y", "y")],
        "inner",
        ssps.connectors(u="input", y="output"),
    )
    outer = ssps.system([inner, ssps.component("c")], [ssps.connection("inner.y", "c.u")])
    described = ssps.described(outer).replace("<ssd:DefaultExperiment", unit + "<ssd:DefaultExperiment")
    entries = {"gain": ssps.real(3.0), "n": '<ssv:Integer value="1"/>', "on": '<ssv:Boolean value="true"/>'}
    entries |= {"mode": '<ssv:Enumeration value="fast"/>', "text": '<ssv:String value="x"/>'}
    return {".ssd": described, ".ssv": ssps.values(entries), ".ssm": NAMES}


def _ssp(suffix: str) -> Target:
    """Documents of an SSP with this suffix, in one whose others are sound."""

    def use(file: Path) -> object:
        whole = file.with_suffix(".ssp")
        contents = {SSP_FILES[other]: text.encode() for other, text in _ssp_files().items()}
        contents |= {SSP_FILES[suffix]: file.read_bytes(), "resources/gain.fmu": _small_gain()}
        archive.write(whole, contents)
        try:
            check(whole)
            return about(whole)
        finally:
            whole.unlink()
            for kept in Path(tempfile.gettempdir()).glob("servotwin-ssp*/*"):  # of this target alone: see `main`
                shutil.rmtree(kept)

    return Target(suffix, use, lambda folder: iter([_ssp_files()[suffix].encode()]))


@cache
def _small_gain() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "gain.fmu"
        described = archive.read(ssps.gain())[XML]
        archive.write(file, {XML: described, "binaries/linux64/gain.so": b""})
        return file.read_bytes()


def _databases(folder: Path) -> Iterator[bytes]:
    yield DBC.encode()
    yield from (file.read_bytes() for file in sorted((ROOT / "scenarios").rglob("*.dbc")))


def _converted(suffix: str) -> Callable[[Path], Iterator[bytes]]:
    """A database in another format, by cantools."""

    def seeds(folder: Path) -> Iterator[bytes]:
        import cantools

        loaded = cantools.database.load_string(DBC, "dbc")
        yield {"kcd": loaded.as_kcd_string, "sym": loaded.as_sym_string}[suffix[1:]]().encode()

    return seeds


ARXML = """<?xml version="1.0" encoding="UTF-8"?>
<AUTOSAR xmlns="http://autosar.org/schema/r4.0"><AR-PACKAGES><AR-PACKAGE><SHORT-NAME>Cluster</SHORT-NAME><ELEMENTS>
<CAN-CLUSTER><SHORT-NAME>Bus</SHORT-NAME><CAN-CLUSTER-VARIANTS><CAN-CLUSTER-CONDITIONAL><BAUDRATE>500000</BAUDRATE>
<PHYSICAL-CHANNELS><CAN-PHYSICAL-CHANNEL><SHORT-NAME>Ch</SHORT-NAME><FRAME-TRIGGERINGS><CAN-FRAME-TRIGGERING>
<SHORT-NAME>T</SHORT-NAME><FRAME-REF DEST="CAN-FRAME">/Cluster/State</FRAME-REF>
<CAN-ADDRESSING-MODE>STANDARD</CAN-ADDRESSING-MODE><IDENTIFIER>256</IDENTIFIER></CAN-FRAME-TRIGGERING>
</FRAME-TRIGGERINGS></CAN-PHYSICAL-CHANNEL></PHYSICAL-CHANNELS></CAN-CLUSTER-CONDITIONAL></CAN-CLUSTER-VARIANTS>
</CAN-CLUSTER><CAN-FRAME><SHORT-NAME>State</SHORT-NAME><FRAME-LENGTH>8</FRAME-LENGTH></CAN-FRAME>
</ELEMENTS></AR-PACKAGE></AR-PACKAGES></AUTOSAR>
"""


def _arxml(folder: Path) -> Iterator[bytes]:
    yield ARXML.encode()


def _logs(suffix: str) -> Callable[[Path], Iterator[bytes]]:
    def seeds(folder: Path) -> Iterator[bytes]:
        file = folder / f"seed{suffix}"
        logs.write(file, [any_frames(20)], lost=Counter())
        yield file.read_bytes()

    return seeds


def _text_logs(folder: Path) -> Iterator[bytes]:
    """Of every tool: the first lines tell which."""
    yield from (text_of(kind, range(12)).encode() for kind in KINDS)


def _recordings(suffix: str) -> Callable[[Path], Iterator[bytes]]:
    def seeds(folder: Path) -> Iterator[bytes]:
        time = np.arange(12) * 0.1
        trace = Trace(time, {"u": np.sin(time), "y": np.cos(time)}, {"u": "V", "y": "rad"}, "seed")
        file = folder / f"seed{suffix}"
        formats.write(trace, file)
        yield file.read_bytes()

    return seeds


def _tables(folder: Path) -> Iterator[bytes]:
    yield from _recordings(".csv")(folder)
    yield "Zeit [s];Drehzahl [1/min];Winkel [°]\n0,001;1.234,5;0,1\n0,002;1.234,6;0,2\n".encode("cp1252")
    yield "Timestamp,Torque [Nm]\n2026-11-28 09:15:00.002,0.1\n2026-11-28 09:15:00.004,0.2\n".encode("utf-16")
    yield b"# a preamble\n# of two lines\nt\tu\ty\n[ms]\t[V]\t[rad]\n1\t2\t3\n2\t3\t4\n"


PARAMETERS = (
    b"name,value,unit,min,max\nhand.inertia,32,kg.cm2,2,200\n# a remark\n\nhand.gravity,9.81,,,\n",
    b'\xef\xbb\xbfmax;unit;value;name\n;"N.m";1e-3;hand.torque\n',
)


def _yaml(pattern: str, key: bytes) -> Callable[[Path], Iterator[bytes]]:
    def seeds(folder: Path) -> Iterator[bytes]:
        shutil.copytree(ROOT / "scenarios", folder / "scenarios", dirs_exist_ok=True)
        for file in sorted((ROOT / "scenarios").glob(pattern)):
            content = file.read_bytes()
            if key in content:
                yield content

    return seeds


TARGETS: dict[str, Target] = {
    "description": Target(".xml", _describe, _descriptions),
    "archive": Target(".fmu", about, lambda folder: iter([_fmu(folder)])),
    **{f"ssp{suffix}": _ssp(suffix) for suffix in SSP_FILES},
    "dbc": Target(".dbc", load_database, _databases),
    "arxml": Target(".arxml", load_database, _arxml),
    "eds": Target(".eds", load_database, lambda folder: iter([EDS.encode()])),
    "kcd": Target(".kcd", load_database, _converted(".kcd")),
    "sym": Target(".sym", load_database, _converted(".sym")),
    **{
        f"log{suffix}": Target(suffix, about, _logs(suffix))
        for suffix in (".asc", ".log", ".trc", ".blf", ".csv", ".db", ".mf4")
    },
    "log.txt": Target(".txt", about, _text_logs),
    "table": Target(".csv", about, _tables),
    "text": Target(".txt", about, _tables),
    "parameters": Target(".csv", read_parameters, lambda folder: iter(PARAMETERS)),
    "mat": Target(".mat", about, _recordings(".mat")),
    "parquet": Target(".parquet", about, _recordings(".parquet")),
    "scenario": Target(".yaml", load_scenario, _yaml("butterfly/*.yaml", b"run:")),
    "study": Target(".yaml", load_study, _yaml("*/*.yaml", b"method:")),
}


def seeds(name: str, folder: Path) -> Sequence[bytes]:
    """Sound files of a target."""
    return list(TARGETS[name].seeds(folder))
