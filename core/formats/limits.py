"""How much a file may ask of this machine."""

from __future__ import annotations

from dataclasses import dataclass

KIB, MIB, GIB = 1 << 10, 1 << 20, 1 << 30


@dataclass(frozen=True)
class Limits:
    """How much a file may ask of this machine; beyond, it is refused with `TooLargeError`."""

    max_unpacked_bytes: int = 16 * GIB  # of all members of an archive, counted while they are unpacked
    max_ratio: float = 200.0  # unpacked over packed, beyond `ratio_free_bytes`
    ratio_free_bytes: int = 64 * MIB
    max_members: int = 1000
    max_rows: int = 4_000_000_000  # of one stream
    max_columns: int = 1000
    max_header_bytes: int = 64 * KIB
    max_line_bytes: int = MIB
    max_footer_bytes: int = 16 * MIB  # of a parquet file
    max_decode_bytes: int = 2 * GIB  # memory to decode a parquet file's batches in
    max_json_bytes: int = 4 * MIB
    max_json_depth: int = 32
    max_names: int = 4096  # different beacon names in one stream
    unordered: frozenset[str] = frozenset()  # streams whose stamps may go back: who reads them mends that
