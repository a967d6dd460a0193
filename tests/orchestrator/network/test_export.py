"""Models become network FMUs: they send what their database says with what they give, and take what they receive."""

from __future__ import annotations

import ctypes
import itertools
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from cantools.database import load_string
from fmpy.fmi3 import FMU3Slave, fmi3Binary
from fmpy.validation import validate_fmu
from lxml import etree

from fmus.errors import DatabaseError, InputError, ServotwinError
from fmus.modelling import ops
from fmus.modelling.model import Model, State, Variable, input_, output, parameter
from fmus.packaging import archive, targets
from fmus.packaging.native import compiler
from orchestrator.can.database.protection import checksum
from orchestrator.can.ls_bus.operations import Transmit, TransmitFd, decoded, encoded
from orchestrator.engine import Result
from orchestrator.info import about
from orchestrator.network.export import exported
from orchestrator.scenario.run import run_scenario
from tests.support.commands import servotwin
from tests.support.fmus.either import schema

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not compiler.available(), reason="there is no C compiler")]
Run = Callable[..., Result]

HEAD = """VERSION ""
NS_ :
BS_:
BU_: One Other
"""
CYCLES = """BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "ChecksumSignal" STRING;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
BA_DEF_DEF_ "ChecksumSignal" "";
"""
LAYOUT = (
    HEAD
    + """BO_ 256 Mixed: 8 One
 SG_ a : 3|12@0- (0.01,1) [-15|15] "V" Other
 SG_ b : 16|7@1+ (0.5,-3) [-3|60] "V" Other
 SG_ alive_counter : 24|4@1+ (1,0) [0|15] "" Other
 SG_ spare : 28|4@1+ (1,0) [0|15] "" Other
 SG_ c : 32|16@1- (1,0) [-30000|30000] "mV" Other
 SG_ check : 48|8@1+ (1,0) [0|255] "" Other

BO_ 2147484160 Single: 8 One
 SG_ d : 0|32@1- (1,0) [0|0] "V" Other

BO_ 300 Wide: 16 One
 SG_ e : 7|64@0- (1,0) [0|0] "V" Other
 SG_ f : 100|13@1- (0.25,0) [0|0] "V" Other

"""
    + CYCLES
    + """BA_ "GenMsgCycleTime" BO_ 2147484160 25;
BA_ "ChecksumSignal" BO_ 256 "check";
SIG_VALTYPE_ 2147484160 d : 1;
SIG_VALTYPE_ 300 e : 2;
"""
)
NAMES = "abcdef"


def giver() -> Model:
    """Sines of several sizes."""
    heights = {"a": 12.0, "b": 40.0, "c": 20.0, "d": 1e6, "e": 1e-9, "f": 500.0}
    return Model(
        name="giver",
        description="Six sines",
        variables=(*(output(name, "V", "Sine") for name in NAMES), parameter("speed", "rad/s", 7.0, "Of all")),
        outputs=lambda t, x, u, p: {name: height * ops.sin(p.speed * t) for name, height in heights.items()},
    )


def taker() -> Model:
    return Model(
        name="taker",
        description="Six values as they come",
        variables=(
            *(input_(name, "V", "Received") for name in NAMES),
            *(output(f"got_{name}", "V", "The same") for name in NAMES),
        ),
        outputs=lambda t, x, u, p: {f"got_{name}": getattr(u, name) for name in NAMES},
    )


def plant() -> Model:
    return Model(
        name="drive_on_bus",
        description="A speed that follows a voltage, and its integral",
        variables=(input_("voltage", "V", "In"), output("position", "V", "Integral"), output("speed", "V", "Out")),
        states=(State("position", 0.0, "V"), State("speed", 0.0, "V")),
        derivatives=lambda t, x, u, p: {"position": x.speed, "speed": 10.0 * (u.voltage - x.speed)},
        solver_step=lambda p: 0.01,
    )


def on_bus(model: Model, text: str, folder: Path) -> Path:
    file = folder / "lines.dbc"
    file.write_text(text)
    network = exported(model, file).network
    return targets.build(model, folder / f"{model.name}.fmu", target="native", fmi=3, network=network)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("exported")
    return {model.name: on_bus(model, LAYOUT, folder) for model in (giver(), taker())}


@pytest.fixture
def carried(built: dict[str, Path], run: Run) -> Result:
    parts: dict[str, Any] = {"g": (built["giver"], {}), "t": (built["taker"], {})}
    return run(parts, {"can0": {"nodes": ["g.lines", "t.lines"], "bitrate": 500_000}}, step=0.005)


def test_it_is_valid_and_says_what_it_is(built: dict[str, Path]) -> None:
    for path in built.values():
        assert validate_fmu(str(path)) == []
        described = etree.fromstring(archive.read(path)["terminalsAndIcons/terminalsAndIcons.xml"])
        etree.XMLSchema(etree.parse(schema(3).with_name("fmi3TerminalsAndIcons.xsd"))).assertValid(described)
    files = archive.read(built["giver"])
    assert files["extra/org.fmi-standard.fmi-ls-bus/lines.dbc"].decode() == LAYOUT
    assert b'isBusSimulationFMU="false"' in files["extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml"]
    description = fmpy.read_model_description(str(built["taker"]))
    causes = {variable.name: variable.causality for variable in description.modelVariables}
    assert {causes[name] for name in NAMES} == {"local"}
    assert causes["BusNotifications"] == "parameter"


def test_frames_go_out_at_their_periods_and_hold_what_the_model_gives(carried: Result) -> None:
    messages = {one.frame_id: one for one in load_string(LAYOUT, "dbc").messages}
    heights = {"a": 12.0, "b": 40.0, "c": 20.0, "d": 1e6, "e": 1e-9, "f": 500.0}
    seen: dict[str, int] = {}
    for message in carried.carried["can0"].frames.messages():
        spec = messages[message.arbitration_id]
        number = seen[spec.name] = seen.get(spec.name, -1) + 1
        due = number * spec.cycle_time / 1000
        assert 0 < message.timestamp - due < 1e-3
        assert message.is_fd == (spec.name == "Wide")
        values = spec.decode(bytes(message.data[: spec.length]), decode_choices=False)
        for name in NAMES:
            if name not in values:
                continue
            signal = spec.get_signal_by_name(name)
            given = heights[name] * np.sin(7.0 * due) * (1000 if signal.unit == "mV" else 1)
            low = -np.inf if signal.minimum is None else signal.minimum
            high = np.inf if signal.maximum is None else signal.maximum
            if low < high:
                given = min(max(given, low), high)
            slack = abs(given) * 1e-7 if signal.is_float else 0.5001 * signal.scale
            assert values[name] == pytest.approx(given, abs=slack + 1e-18), (name, due)
    assert seen == {"Mixed": 99, "Single": 39, "Wide": 99}


def test_counter_and_checksum_are_filled_in(carried: Result) -> None:
    frames = [m for m in carried.carried["can0"].frames.messages() if m.arbitration_id == 256]
    assert [m.data[3] & 15 for m in frames] == [number % 16 for number in range(len(frames))]
    assert [m.data[6] for m in frames] == [checksum(bytes(m.data), "CRC8_SAE_J1850", 6, None) for m in frames]


def test_what_is_received_is_what_was_sent_rounded_by_its_frame(carried: Result) -> None:
    trace = carried.trace
    late = np.arange(5, len(trace.time) - 1)
    for name, scale in {"a": 0.01, "b": 0.5, "c": 1e-3, "f": 0.25}.items():
        sent, got = trace[f"g.{name}"], trace[f"t.got_{name}"]
        limited = np.clip(sent, *{"a": (-15, 15), "b": (-3, 60), "c": (-30, 30)}.get(name, (-np.inf, np.inf)))
        slope = np.max(np.abs(np.diff(limited)))
        assert np.max(np.abs(got[late + 1] - limited[late])) <= 0.51 * scale + 4 * slope, name
    sent = 1e-9 * np.sin(7.0 * 0.01 * np.arange(101))
    assert max(np.min(np.abs(sent - got)) for got in trace["t.got_e"]) < 1e-24


def test_a_loop_over_a_bus_is_the_wired_one_but_for_rounding_and_delay(tmp_path: Path, scenario: Any) -> None:
    rig = (
        HEAD
        + (
            'BO_ 256 Command: 2 One\n SG_ voltage : 0|16@1- (0.001,0) [-20|20] "V" Other\n\n'
            'BO_ 257 State: 4 Other\n SG_ position : 0|16@1- (0.0005,0) [-16|16] "V" One\n'
            ' SG_ speed : 16|16@1- (0.001,0) [-30|30] "V" One\n\n'
        )
        + CYCLES.replace('GenMsgCycleTime" 10', 'GenMsgCycleTime" 5')
    )
    from fmus import library

    values = {"sample_time": 0.005, "compensated_by": "none", "kp": 2.0}
    controller, drive = on_bus(library.find("pd"), rig, tmp_path), on_bus(plant(), rig, tmp_path)
    drive_model = targets.build(plant(), tmp_path / "plain.fmu", target="native", fmi=3)
    stimuli = {"stimuli": {"c.reference": {"constant": 1.0}}}
    parts: dict[str, Any] = {"c": (controller, values), "p": (drive, {})}
    bus = {"can0": {"nodes": ["c.lines", "p.lines"], "bitrate": 1_000_000}}
    over = run_scenario(scenario(parts, bus, step=0.001, stop=5, more=stimuli)).cases[0].trace
    file = scenario({"c": (controller, values), "p": (drive_model, {})}, {}, step=0.001, stop=5, more=stimuli)
    document = json.loads(file.read_text())
    document["components"]["c"] = {"model": "pd", "parameters": values}
    document["connections"] = ["p.position -> c.position", "p.speed -> c.speed", "c.voltage -> p.voltage"]
    file.write_text(json.dumps(document))
    wired = run_scenario(file).cases[0].trace
    assert over["p.position"][-1] == pytest.approx(wired["p.position"][-1], abs=0.005)
    assert np.max(np.abs(over["p.position"] - wired["p.position"])) < 0.02


def test_another_importer_ticks_it_by_the_standard(built: dict[str, Path], tmp_path: Path) -> None:
    folder = fmpy.extract(str(built["giver"]), str(tmp_path))
    description = fmpy.read_model_description(folder)
    fmu = _slave(folder, description)
    fmu.instantiate(eventModeUsed=True)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    time, found = 0.0, []
    clock = (ctypes.c_uint * 1)(references["lines.Tx_Clock"])
    data = (ctypes.c_uint * 1)(references["lines.Tx_Data"])
    for _ in range(5):
        interval, qualifier = (ctypes.c_double * 1)(), (ctypes.c_int * 1)()
        fmu.fmi3GetIntervalDecimal(fmu.component, clock, 1, interval, qualifier)
        assert qualifier[0] == 2
        if interval[0] > 0:
            fmu.enterStepMode()
            fmu.doStep(time, interval[0])
            time += interval[0]
            fmu.enterEventMode()
        fmu.fmi3SetClock(fmu.component, clock, 1, (ctypes.c_bool * 1)(True))
        sizes, values = (ctypes.c_size_t * 1)(), (fmi3Binary * 1)()
        fmu.fmi3GetBinary(fmu.component, data, 1, sizes, values, 1)
        found.append((round(time, 6), decoded(ctypes.string_at(values[0], sizes[0]))))
        fmu.updateDiscreteStates()
    fmu.terminate()
    fmu.freeInstance()
    assert [at for at, _ in found] == [0.0, 0.01, 0.02, 0.025, 0.03]
    both = [256, 300]
    ids = [[one.id for one in sent if isinstance(one, Transmit | TransmitFd)] for _, sent in found]
    assert ids == [[256, 512, 300], both, both, [512], both]
    assert {type(one) for _, sent in found for one in sent} == {Transmit, TransmitFd}


def _slave(folder: str, description: Any) -> FMU3Slave:
    return FMU3Slave(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="g",
    )


def test_without_event_mode_it_steps_and_says_that_it_is_on_no_bus(built: dict[str, Path]) -> None:
    said: list[str] = []
    fmpy.simulate_fmu(str(built["giver"]), stop_time=0.1, logger=lambda *args: said.append(args[-1].decode()))
    assert any("exchanges nothing with its bus" in line for line in said)


def test_what_there_is_in_it_tells_of_its_terminal(built: dict[str, Path]) -> None:
    document: Any = about(built["giver"])
    (terminal,) = document["terminals"]
    assert (terminal["name"], terminal["kind"]) == ("lines", "org.fmi-ls-bus.network-terminal")
    assert terminal["members"] == "Rx_Clock, Rx_Data, Tx_Clock, Tx_Data, Configuration (BusNotifications)"


def test_the_sources_of_its_bus_compile_without_a_warning(built: dict[str, Path], tmp_path: Path) -> None:
    for name, text in archive.read(built["taker"]).items():
        if name.startswith("sources/"):
            (tmp_path / Path(name).name).write_bytes(text)
    strict = ["-Wall", "-Wextra", "-Wconversion", "-Werror", "-fsyntax-only"]
    command = compiler.command_for(compiler.host())
    languages = [["-std=c99"], *([["-x", "c++", "-std=c++17"]] if shutil.which("c++") else [])]
    for language, unit in itertools.product(languages, sorted(tmp_path.glob("*network.c"))):
        done = subprocess.run([*command, *language, *strict, str(unit)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def received(fmu: Path, folder: Path, variable: str, operations: list[Transmit]) -> list[float]:
    """What a variable is after each of these, one after the other."""
    place = fmpy.extract(str(fmu), str(folder))
    description = fmpy.read_model_description(place)
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    slave, found = _slave(place, description), []
    slave.instantiate(eventModeUsed=True)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    clock, place_of_data = ((ctypes.c_uint * 1)(references[f"lines.Rx_{name}"]) for name in ("Clock", "Data"))
    for operation in operations:
        whole = ctypes.create_string_buffer(encoded([operation]), len(encoded([operation])))
        slave.fmi3SetClock(slave.component, clock, 1, (ctypes.c_bool * 1)(True))
        sizes, values = (ctypes.c_size_t * 1)(len(whole)), (fmi3Binary * 1)(ctypes.cast(whole, fmi3Binary))
        slave.fmi3SetBinary(slave.component, place_of_data, 1, sizes, values, 1)
        slave.updateDiscreteStates()
        found += slave.getFloat64([references[variable]])
    slave.terminate()
    slave.freeInstance()
    return found


def test_a_frame_that_is_too_short_or_another_is_not_taken(built: dict[str, Path], tmp_path: Path) -> None:
    given = [
        Transmit(512, True, False, 2, b"\1\2"),
        Transmit(512, True, False, 4, np.float32(2.5).tobytes()),
        Transmit(512, True, False, 8, np.float32(2.5).tobytes() + bytes(4)),
        Transmit(512, False, False, 8, np.float32(9.5).tobytes() + bytes(4)),
    ]
    assert received(built["taker"], tmp_path, "got_d", given) == [0.0, 0.0, 2.5, 2.5]


def mixed(value: float, count: int, damage: int = 0) -> Transmit:
    """A frame with this value in `a`."""
    spec = next(one for one in load_string(LAYOUT, "dbc").messages if one.name == "Mixed")
    signals = {"a": value, "b": 0, "alive_counter": count, "spare": 0, "c": 0, "check": 0}
    data = bytearray(spec.encode(signals, strict=False))
    data[6] = checksum(bytes(data), "CRC8_SAE_J1850", 6, None) ^ damage
    return Transmit(256, False, False, 8, bytes(data))


def test_a_frame_that_cannot_be_trusted_changes_nothing(built: dict[str, Path], tmp_path: Path) -> None:
    given = [mixed(3, 7), mixed(4, 8, damage=1), mixed(5, 8), mixed(6, 8), mixed(7, 9), mixed(8, 1)]
    assert received(built["taker"], tmp_path, "got_a", given) == pytest.approx([3, 3, 5, 5, 7, 8])


@pytest.mark.parametrize("odd", ["sqrt(at - t)", "infinite"])
def test_a_frame_with_what_is_not_finite_is_not_sent(
    tmp_path: Path, run: Run, odd: str, caplog: pytest.LogCaptureFixture
) -> None:
    def outputs(t: Any, x: Any, u: Any, p: Any) -> dict[str, Any]:
        broken = ops.sqrt(p.at - t) if odd != "infinite" else 1.0 / ops.sqrt(ops.maximum(p.at - t, 0.0))
        return {"a": broken, "d": t}

    names = (output("a", "V", "Breaks"), output("d", "V", "Goes on"), parameter("at", "s", 0.5, "When"))
    breaks = on_bus(Model(name="breaks", description="Breaks", variables=names, outputs=outputs), LAYOUT, tmp_path)
    bus = {"can0": {"nodes": ["g.lines"], "bitrate": 500_000}}
    done = run({"g": (breaks, {})}, bus, step=0.005, nonfinite="allow")
    frames = list(done.carried["can0"].frames.messages())
    times = {number: [one.timestamp for one in frames if one.arbitration_id == number] for number in (256, 512)}
    assert 0.48 < times[256][-1] < 0.52 and times[512][-1] > 0.97
    assert re.search(r"'a' is (-?nan|inf): frame 'Mixed' is not sent", caplog.text)


def test_a_checksum_does_not_count_what_fills_a_frame_up(tmp_path: Path, run: Run) -> None:
    text = LAYOUT.replace("BO_ 300 Wide: 16 One", 'BO_ 300 Wide: 10 One\n SG_ seal : 72|8@1+ (1,0) [0|255] "" Other')
    text = text.replace(' SG_ f : 100|13@1- (0.25,0) [0|0] "V" Other\n', "")
    sealed = on_bus(giver(), text + 'BA_ "ChecksumSignal" BO_ 300 "seal";\n', tmp_path)
    bus = {"can0": {"nodes": ["g.lines"], "bitrate": 500_000}}
    frames = run({"g": (sealed, {})}, bus, step=0.005).carried["can0"].frames.messages()
    wide = [bytes(one.data) for one in frames if one.arbitration_id == 300]
    assert len(wide) > 50 and {len(data) for data in wide} == {12}
    assert [data[9] for data in wide] == [checksum(data[:10], "CRC8_SAE_J1850", 9, None) for data in wide]


def changed(*pairs: tuple[str, str]) -> str:
    text = LAYOUT
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return text


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (
            re.sub(r"SG_ [a-f] ", "SG_ other ", LAYOUT),
            r"has no signal that is called as a variable of giver; it has a, b",
        ),
        (changed(('"V" Other', '"K" Other')), r"Mixed\.a: .*K"),
        (
            changed(('"GenMsgCycleTime" 10', '"GenMsgCycleTime" 0')),
            r"Mixed: has no period, .*give it a GenMsgCycleTime",
        ),
        (changed(("SIG_VALTYPE_ 300 e : 2;", ""), ("(0.01,1)", "(0,1)")), r"Mixed\.a: its factor is 0"),
    ],
)
def test_a_database_that_does_not_fit_the_model_names_the_place(tmp_path: Path, text: str, why: str) -> None:
    (tmp_path / "lines.dbc").write_text(text)
    with pytest.raises(ServotwinError, match=why) as told:
        exported(giver(), tmp_path / "lines.dbc")
    assert told.value.exit_code == 2


def test_a_message_has_one_sender_and_an_input_one_message(tmp_path: Path) -> None:
    (tmp_path / "lines.dbc").write_text(LAYOUT)
    both = Model(
        name="both",
        description="Takes a and gives b",
        variables=(input_("a", "V", "In"), output("b", "V", "Out")),
        outputs=lambda t, x, u, p: {"b": u.a},
    )
    with pytest.raises(DatabaseError, match=r"Mixed: has b, an output of both, and a, an input; a message has one"):
        exported(both, tmp_path / "lines.dbc")
    (tmp_path / "lines.dbc").write_text(changed(("SG_ f :", "SG_ d :")))
    with pytest.raises(DatabaseError, match=r"d: is in Single and in Wide, which would set one input"):
        exported(taker(), tmp_path / "lines.dbc")


def test_a_whole_variable_takes_no_broken_values(tmp_path: Path) -> None:
    (tmp_path / "lines.dbc").write_text(LAYOUT)
    counting = Model(
        name="counting",
        description="A count",
        variables=(Variable("b", "V", "input", "In", 0), output("y", "V", "Out")),
        outputs=lambda t, x, u, p: {"y": u.b},
    )
    with pytest.raises(DatabaseError, match=r"Mixed\.b: has values that are not whole, and b is Integer"):
        exported(counting, tmp_path / "lines.dbc")


def test_only_native_fmus_for_fmi_3_are_on_a_bus(tmp_path: Path) -> None:
    (tmp_path / "lines.dbc").write_text(LAYOUT)
    network = exported(giver(), tmp_path / "lines.dbc").network
    with pytest.raises(
        InputError, match=r"a network FMU: is not FMI 2 by target 'native'; use --target native --fmi 3"
    ):
        targets.build(giver(), tmp_path / "g.fmu", target="native", network=network)
    with pytest.raises(InputError, match=r"is no DBC"):
        exported(giver(), tmp_path / "lines.sym")


def test_the_command_builds_network_fmus_and_tells_what_is_in_no_frame(tmp_path: Path) -> None:
    (tmp_path / "rig.dbc").write_text(LAYOUT.replace("SG_ a :", "SG_ voltage :"))
    command = ["build", "pd", "--bus", str(tmp_path / "rig.dbc"), "--out", str(tmp_path), "--json"]
    told = json.loads(servotwin(*command, "--fmi", "3").stdout)["buses"]["pd"]
    assert told["terminal"] == "rig"
    assert [(frame["name"], frame["variables"]) for frame in told["frames"]] == [("Mixed", ["voltage"])]
    assert "reference, position, speed, effort, compensation: in no frame, and as without a bus" in told["notes"]
    assert "Mixed: b, spare, c rest at the initial value, or zero" in told["notes"]
    refused = servotwin(*command)
    assert (refused.exit_code, "use --target native --fmi 3" in refused.stderr) == (2, True)
    nobody = servotwin("build", "--fmi", "3", "--bus", str(tmp_path / "rig.dbc"))
    assert (nobody.exit_code, "--bus: is for models that are named" in nobody.stderr) == (2, True)
