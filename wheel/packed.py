"""Writes wheels with short streams: libdeflate's, a thirtieth shorter than zlib's, where the
package `deflate` is installed, as it is for a release; else zlib's."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from struct import pack
from zipfile import ZIP_DEFLATED, ZipInfo

# An entry's header before its data and in the directory, and the directory's end (APPNOTE.TXT 4.3).
LOCAL, CENTRAL, END = "<4s5H3I2H", "<4s6H3I5H2I", "<4s4H2IH"
UTF8, VERSION, UNIX = 0x800, 20, 3 << 8


def write(path: Path, entries: Iterable[tuple[ZipInfo, bytes]]) -> None:
    """Writes an archive; of each entry its name, time and permissions, and its data."""
    compress = _compressor()
    directory = []
    with path.open("wb") as file:
        for info, data in entries:
            offset, stream = file.tell(), compress(data)
            name = info.filename.encode()
            year, month, day, hour, minute, second = info.date_time
            time = hour << 11 | minute << 5 | second // 2
            date = (year - 1980) << 9 | month << 5 | day
            what = (VERSION, UTF8, ZIP_DEFLATED, time, date)
            size = (zlib.crc32(data), len(stream), len(data))
            file.write(pack(LOCAL, b"PK\3\4", *what, *size, len(name), 0) + name + stream)
            place = (len(name), 0, 0, 0, 0, info.external_attr, offset)
            entry = pack(CENTRAL, b"PK\1\2", UNIX | VERSION, *what, *size, *place)
            directory.append(entry + name)
        begin, whole = file.tell(), b"".join(directory)
        count = len(directory)
        file.write(whole + pack(END, b"PK\5\6", 0, 0, count, count, len(whole), begin, 0))


def _compressor() -> Callable[[bytes], bytes]:
    try:
        from deflate import deflate_compress
    except ImportError:
        return _by_zlib
    return lambda data: bytes(deflate_compress(data, 12))


def _by_zlib(data: bytes) -> bytes:
    stream = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    return stream.compress(data) + stream.flush()
