"""Files: atomic writing, tables of numbers as text, TOML settings, NetCDF.

A file is written under a temporary name in the same folder, forced to the disk and then renamed. Whoever looks sees
the earlier file or the complete new one, never a part, also after a full disk, a crash or Ctrl-C.
"""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.files.hdf5 import (
        NetCDF,
        Variable,
        check_size,
        most_bytes,
        open_hdf5,
        read_netcdf,
        write_netcdf,
    )
    from hyperflex.files.json import dumps_json, plain, write_json
    from hyperflex.files.reading import LARGEST, not_damaged, read_bytes, read_text, regular_file
    from hyperflex.files.tables import (
        Table,
        cells_of,
        filled,
        joined_names,
        mark_of,
        no_repeats,
        read_lines,
        read_table,
        table_of,
        write_table,
    )
    from hyperflex.files.toml import dumps_toml, loads_toml, read_toml, toml_words, write_toml
    from hyperflex.files.writing import (
        PathLike,
        as_path,
        atomic,
        atomic_path,
        check_space,
        check_writable,
        remove_left_behind,
        rescued,
        write_bytes,
        write_text,
    )

__getattr__, __dir__, __all__ = attach(__name__, __file__)
