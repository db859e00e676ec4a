"""Registries of message types that do not depend on the installation."""

from retalis import Definitions
from retalis.messages.decoder import Decoder
from retalis.messages.type_definition import MAX_EMPTY_ELEMENTS
from retalis.messages.type_registry import InstalledTypes


def empty_registry(max_empty_elements: int = MAX_EMPTY_ELEMENTS) -> Definitions:
    """Return a registry without installed types."""
    return Definitions(InstalledTypes([], [], include_rosbags=False), max_empty_elements)


def decoder_of(text: str, name: str = "pkg/Type") -> Decoder:
    """Return the decoder of a type with a definition."""
    registry = empty_registry()
    return registry.decoder(registry.add(name, text))


def section(name: str, text: str) -> str:
    """Return the part of a definition that defines a nested type."""
    return "=" * 80 + f"\nMSG: {name}\n{text}"
