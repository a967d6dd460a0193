"""Names of the standard: namespaces, types of files, and elements of other tools that tell a step."""

from enum import StrEnum


class Version(StrEnum):
    """Versions of SSP; they share their namespaces."""

    ONE = "1.0"
    TWO = "2.0"


SSD = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"
SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
SSC = "{http://ssp-standard.org/SSP1/SystemStructureCommon}"
SSM = "{http://ssp-standard.org/SSP1/SystemStructureParameterMapping}"
SSB = "{http://ssp-standard.org/SSP1/SystemStructureSignalDictionary}"

FMU = "application/x-fmu-sharedlibrary"
DEFINITION = "application/x-ssp-definition"
PACKAGE = "application/x-ssp-package"
PARAMETERS = "application/x-ssp-parameter-set"
MAPPING = "application/x-ssp-parameter-mapping"
DICTIONARY = "application/x-ssp-signal-dictionary"

STEPS = ("stepSize", "baseStepSize", "initialStepSize")  # of OMSimulator's and libcosim's annotations
