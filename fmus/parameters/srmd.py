"""Where a parameter set comes from, as Simulation Resource Meta Data of SSP Traceability 1.0 beside it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from xml.etree import ElementTree as ET

from fmus.packaging.description.xml import GENERATION_TOOL, document

SRMD = "http://ssp-standard.org/SSPTraceability1/SimulationResourceMetaData"
STC = "http://ssp-standard.org/SSPTraceability1/SSPTraceabilityCommon"
ET.register_namespace("srmd", SRMD)
ET.register_namespace("stc", STC)


def meta_data(name: str, file: str, content: bytes, facts: Mapping[str, Mapping[str, str]]) -> bytes:
    """The document about a file that lies beside it.

    Args:
        content: of the file, whose hash (SHA3-256) says which it is about.
        facts: kind of facts -> keyword -> text.
    """
    about = {"version": "1.0.0", "name": name, "data": file, "generationTool": GENERATION_TOOL}
    about |= {"checksum": hashlib.sha3_256(content).hexdigest(), "checksumType": "SHA3-256"}
    root = ET.Element(f"{{{SRMD}}}SimulationResourceMetaData", about)
    for kind, entries in facts.items():
        classification = ET.SubElement(root, f"{{{STC}}}Classification", {"type": f"org.servotwin.{kind}"})
        for keyword, text in entries.items():
            entry = ET.SubElement(classification, f"{{{STC}}}ClassificationEntry", {"keyword": keyword})
            entry.text = text
    return document(root)
