"""What a network FMU says of its bus: variables, terminal, manifest and database, after FMI-LS-BUS 1.0."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from xml.etree import ElementTree as ET

from fmus.modelling.model import Model, parameter
from fmus.packaging.description import xml
from fmus.packaging.native.network import Network

NOTIFICATIONS = "BusNotifications"
EXTRA = "extra/org.fmi-standard.fmi-ls-bus"
_MIME = 'application/org.fmi-standard.fmi-ls-bus.can; version="1.0.0"'
_KIND = "org.fmi-ls-bus.network-terminal"
_LS = "http://fmi-standard.org/fmi-ls-manifest"
_NAMES = ("Rx_Data", "Tx_Data", "Rx_Clock", "Tx_Clock")
_MOST = 4096  # bytes of what is received at once, as in network.h


def notified(model: Model) -> Model:
    """The model with the parameter that says whether its bus tells it what becomes of its frames."""
    text = "Whether the bus tells what becomes of frames; they are sent all the same"
    return replace(model, variables=(*model.variables, parameter(NOTIFICATIONS, "1", False, text)))


def variables(network: Network, first: int) -> list[ET.Element]:
    """Data and clocks of the bus, with value references from `first` on."""
    rx, tx, rx_clock, tx_clock = (f"{network.name}.{name}" for name in _NAMES)
    data = {"variability": "discrete", "mimeType": _MIME}
    received = _element("Binary", rx, first, "input", data | {"clocks": str(first + 2), "maxSize": str(_MOST)})
    ET.SubElement(received, "Start", value="")
    sent = data | {"clocks": str(first + 3), "initial": "calculated"}
    clock = {"variability": "discrete"}
    return [
        received,
        _element("Binary", tx, first + 1, "output", sent),
        _element("Clock", rx_clock, first + 2, "input", clock | {"intervalVariability": "triggered"}),
        _element("Clock", tx_clock, first + 3, "input", clock | {"intervalVariability": "countdown"}),
    ]


def files(network: Network) -> dict[str, bytes]:
    """Manifest and database by their names in the archive."""
    ET.register_namespace("fmi-ls", _LS)
    said = {"fmi-ls-name": "org.fmi-standard.fmi-ls-bus", "fmi-ls-version": "1.0.0"}
    said |= {"fmi-ls-description": "CAN frames that this FMU sends and receives"}
    manifest = ET.Element("fmiLayeredStandardManifest", {f"{{{_LS}}}{name}": text for name, text in said.items()})
    manifest.set("isBusSimulationFMU", "false")
    return {
        f"{EXTRA}/fmi-ls-manifest.xml": xml.document(manifest),
        f"{EXTRA}/{network.name}.dbc": network.database,
    }


def terminal(network: Network) -> ET.Element:
    """The terminal of the bus."""
    bus = ET.Element("Terminal", _named(network.name, _KIND, "org.fmi-ls-bus.transceiver"))
    for name in sorted(_NAMES):
        _member(bus, f"{network.name}.{name}", name)
    configuration = ET.SubElement(bus, "Terminal", _named("Configuration", f"{_KIND}.configuration", "bus"))
    _member(configuration, NOTIFICATIONS, NOTIFICATIONS)
    return bus


def _named(name: str, kind: str, rule: str) -> dict[str, str]:
    return {"name": name, "matchingRule": rule, "terminalKind": kind}


def _member(parent: ET.Element, variable: str, name: str) -> None:
    said = {"variableName": variable, "memberName": name, "variableKind": "signal"}
    ET.SubElement(parent, "TerminalMemberVariable", said)


def _element(kind: str, name: str, reference: int, causality: str, more: Mapping[str, str]) -> ET.Element:
    return ET.Element(kind, {"name": name, "valueReference": str(reference), "causality": causality, **more})
