"""`wcsim cache`: where built streets are cached, how large the cache is, and how to clear it."""

from __future__ import annotations

from dataclasses import dataclass

from wcsim.cli.shared.common import Flag, OutFile, parse, write_json
from wcsim.core.reading import counted, escaped
from wcsim.errors import ConfigError
from wcsim.towns.cache.folder import cache_facts, clear_cache


@dataclass
class Options:
    """Show the cache of streets, checked nets, machine code and generated places."""

    clear: Flag = False
    """Delete everything in it; what is needed is built again. Running worlds continue."""
    json: OutFile = None
    """Write the result to this file."""


def run(words: list[str]) -> int:
    """Print it, and clear the cache if requested."""
    options = parse(Options, words, "cache")
    before = cache_facts()
    left = clear_cache() if options.clear else before
    checked = counted(before.verdicts, "checked net or scenario", "checked nets and scenarios")
    kept = f"{counted(before.streets, 'street')}, {checked}, {counted(before.kernels, 'kernel')}"
    kept += f", {counted(before.driven, 'generated place')} to drive in, {before.unfinished} unfinished"
    print(f"{escaped(before.folder)}: {kept}, {before.size_bytes / 1e6:.1f} MB")
    if options.clear:
        print(f"removed {(before.size_bytes - left.size_bytes) / 1e6:.1f} MB")
    else:
        print("clear it: wcsim cache --clear")
    result = {"folder": str(before.folder), "streets": before.streets, "verdicts": before.verdicts}
    result |= {"kernels": before.kernels, "driven": before.driven, "unfinished": before.unfinished}
    result |= {"size_bytes": before.size_bytes, "left_bytes": left.size_bytes}
    write_json(options.json, result)
    if options.clear and left.size_bytes:
        raise ConfigError(
            f"{escaped(left.folder)}: {left.size_bytes} bytes are left; expected files that you may remove"
        )
    return 0
