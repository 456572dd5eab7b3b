"""Every setting of the library: frozen dataclasses, each field with a default and a sentence under it.

One module a stage (`ingestion`, `synthesis`, `training`, `evaluation`, `diagnosis`). Nothing heavy is imported here, so
that help pages and `import tossid` stay quick. `conf/` shows the values that a person may want to name; a test holds
each equal to the default here, or its line says why it differs.
"""
