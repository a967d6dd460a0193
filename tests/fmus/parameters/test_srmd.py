"""What a parameter set comes from is said beside it, by its hash."""

from __future__ import annotations

import hashlib
from xml.etree import ElementTree

from fmus.parameters.srmd import SRMD, STC, meta_data


def test_meta_data_names_the_file_by_its_hash_and_holds_every_fact() -> None:
    facts = {"data": {"a.csv": "SHA-256 12ab"}, "interval": {"hand.k": "95 % from 1.0 to 2.0 N.m", '<odd> & "': "é"}}
    root = ElementTree.fromstring(meta_data("rig", "parameters.ssv", b"set", facts))
    assert root.tag == f"{{{SRMD}}}SimulationResourceMetaData"
    assert (root.get("data"), root.get("checksumType")) == ("parameters.ssv", "SHA3-256")
    assert root.get("checksum") == hashlib.sha3_256(b"set").hexdigest()
    found = {
        str(group.get("type")).removeprefix("org.servotwin."): {
            entry.get("keyword"): entry.text for entry in group.findall(f"{{{STC}}}ClassificationEntry")
        }
        for group in root.findall(f"{{{STC}}}Classification")
    }
    assert found == facts
