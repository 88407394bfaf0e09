"""Cut the ELF file out of a bzImage: it is in there as an xz stream. ``uncompressed_kernel.py VMLINUZ VMLINUX``."""

import lzma
import sys
from pathlib import Path

_XZ_MAGIC = b"\xfd7zXZ\x00"
_ELF_MAGIC = b"\x7fELF"


def elf_of(image: bytes) -> bytes:
    """Return the ELF file; raises `ValueError` where there is none."""
    at = image.find(_XZ_MAGIC)
    while at >= 0:
        try:
            found = lzma.LZMADecompressor().decompress(image[at:])
        except lzma.LZMAError:  # the magic bytes were something else's
            found = b""
        if found.startswith(_ELF_MAGIC):
            return found
        at = image.find(_XZ_MAGIC, at + 1)
    raise ValueError("no ELF file in the kernel image")


if __name__ == "__main__":
    Path(sys.argv[2]).write_bytes(elf_of(Path(sys.argv[1]).read_bytes()))
