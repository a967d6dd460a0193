"""FMI-LS-REF: what we write is as its schema has it, and what others write is read."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest
from lxml import etree

from fmus.errors import FmuFileError
from fmus.files import package_folder
from fmus.packaging import archive
from fmus.parameters.related import FOLDER, MANIFEST, Related, manifest, related, state
from fmus.parameters.write_back import write_back

Build = Callable[[str], Path]

ROLES = """document requirement specification model parameter system testcase experiment experiment/smoke-test
    experiment/validation experiment/uncertainty-analysis result method rationale report request delivery configuration
    signature meta-data other"""
TABLES = f"""<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" elementFormDefault="qualified"
    xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest">
  <xs:import namespace="http://fmi-standard.org/fmi-ls-manifest" schemaLocation="fmi3LayeredStandardManifest.xsd"/>
  <xs:include schemaLocation="fmi3Annotation.xsd"/>
  <xs:element name="fmiReferences"><xs:complexType><xs:sequence>
    <xs:element name="Related" minOccurs="0" maxOccurs="unbounded"><xs:complexType><xs:sequence>
      <xs:element name="Label" minOccurs="0" maxOccurs="unbounded"><xs:complexType>
        <xs:attribute name="name" type="xs:string" use="required"/><xs:attribute name="description" type="xs:string"/>
      </xs:complexType></xs:element>
      <xs:element ref="Annotations" minOccurs="0"/></xs:sequence>
      <xs:attribute name="type" type="xs:string"/>
      <xs:attribute name="source" type="xs:anyURI" use="required"/>
      <xs:attribute name="role" use="required"><xs:simpleType><xs:restriction base="xs:string">
        <xs:pattern value="{"|".join(ROLES.split())}|serialized-state(/.*)?"/>
      </xs:restriction></xs:simpleType></xs:attribute>
      <xs:attribute name="description" type="xs:string"/>
      <xs:attribute name="checksum" type="xs:hexBinary"/>
      <xs:attribute name="checksumType" default="SHA3-256"><xs:simpleType><xs:restriction base="xs:string">
        <xs:pattern value="SHA3?-(224|256|384|512)"/></xs:restriction></xs:simpleType></xs:attribute>
      </xs:complexType></xs:element>
    <xs:element ref="Annotations" minOccurs="0"/></xs:sequence>
    <xs:attribute ref="fmi-ls:fmi-ls-name" use="required" fixed="org.fmi-standard.fmi-ls-ref"/>
    <xs:attribute ref="fmi-ls:fmi-ls-version" use="required" fixed="1.0.0-alpha.1"/>
    <xs:attribute ref="fmi-ls:fmi-ls-description" use="required"
      fixed="Layered Standard providing information on related files included in an FMU."/>
  </xs:complexType></xs:element></xs:schema>"""


@pytest.fixture(scope="module")
def schema() -> etree.XMLSchema:
    """The tables of FMI-LS-REF 1.0.0-alpha.1 as a schema, around the schemas of FMI 3.0 that it refers to."""
    base = (package_folder("fmpy") / "schema" / "fmi3" / "ls-ref.xsd").as_uri()
    return etree.XMLSchema(etree.fromstring(TABLES.encode(), base_url=base))


def test_the_manifest_of_a_calibrated_fmu_is_valid(schema: etree.XMLSchema, fmu: Build, tmp_path: Path) -> None:
    write_back(fmu("pendulum"), {"inertia": 0.004}, tmp_path / "calibrated.fmu")
    written = archive.read(tmp_path / "calibrated.fmu")
    schema.assertValid(etree.fromstring(written[MANIFEST]))
    (one,) = related("", written)
    assert one.checksum == hashlib.sha3_256(written[f"{FOLDER}/calibrated.ssv"]).hexdigest()
    assert state(one, written) == "unchanged"


def test_a_role_that_is_none_is_seen_by_the_schema(schema: etree.XMLSchema) -> None:
    wrong = manifest([Related("a.csv", "text/csv", "outcome")], {"a.csv": b""})
    assert not schema.validate(etree.fromstring(wrong))


FOREIGN = b"""<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
    fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref" fmi-ls:fmi-ls-version="1.0.0-alpha.1">
    <Related type="text/csv" source="Ball_out.csv" role="result" description="Output"/>
    <Related source="../../documentation/more%20here.txt" role="document"/>
    <Related source="gone.csv" role="result"/>
    <Related source="https://example.org/a.mo" role="model"/>
    <Related source="b.ssv" role="parameter" checksum="00ff" checksumType="SHA-256"/></fmiReferences>"""


def test_files_that_others_name_are_found_where_they_are() -> None:
    files = {
        MANIFEST: FOREIGN,
        f"{FOLDER}/Ball_out.csv": b"time,h",
        "documentation/more here.txt": b"",
        f"{FOLDER}/b.ssv": b"",
    }
    found = related("ball.fmu", files)
    assert [(one.role, state(one, files)) for one in found] == [
        ("result", "there"),
        ("document", "there"),
        ("result", "missing"),
        ("model", "elsewhere"),
        ("parameter", "changed"),
    ]


def test_what_others_have_named_in_an_fmu_of_ours_stays_named(fmu: Build, tmp_path: Path) -> None:
    path = tmp_path / "named.fmu"
    archive.write(path, {**archive.read(fmu("pendulum")), MANIFEST: FOREIGN})
    for inertia in (0.004, 0.005):
        write_back(path, {"inertia": inertia}, path)
    written = archive.read(path)
    assert [one.source for one in related("", written)] == [
        "calibrated.ssv",
        *(one.source for one in related("", {MANIFEST: FOREIGN})),
    ]
    assert state(related("", written)[0], written) == "unchanged"


def test_a_source_that_leaves_the_fmu_finds_nothing_outside() -> None:
    one = Related("../../../../etc/passwd", "text/plain", "other")
    assert state(one, {"modelDescription.xml": b""}) == "missing"


def test_a_manifest_that_is_no_xml_is_told_by_its_place() -> None:
    with pytest.raises(FmuFileError, match=r"ball\.fmu: extra/org\.fmi-standard\.fmi-ls-ref/fmi-ls-manifest\.xml"):
        related("ball.fmu", {MANIFEST: b"<fmiRef"})
