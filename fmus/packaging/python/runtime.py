"""What every Python FMU takes along of pythonfmu: its modules, and its libraries for all platforms."""

from __future__ import annotations

from fmus.files import package_folder

_LIBRARIES = (".so", ".dll", ".dylib")


def files(model: str) -> dict[str, bytes]:
    """Archive name -> contents; a library has the model's name in each platform's folder."""
    home = package_folder("pythonfmu")
    found = {f"resources/pythonfmu/{file.name}": file.read_bytes() for file in home.glob("*.py")}
    for library in (home / "resources" / "binaries").rglob("*.*"):
        if library.suffix in _LIBRARIES:
            found[f"binaries/{library.parent.name}/{model}{library.suffix}"] = library.read_bytes()
    return found
