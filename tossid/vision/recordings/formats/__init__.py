"""Formats of recordings, one file a format. Help pages import all of them: heavy libraries belong inside functions."""
