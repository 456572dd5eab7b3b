"""Every setting of the library: frozen dataclasses, each field with a default and a sentence under it.

One module a stage (`ingestion`, `synthesis`, `training`, `evaluation`, `diagnosis`). Nothing heavy is imported here, so
that help pages and `import tossid` stay quick. `conf/` holds presets by name, and no default of these twice.
"""
