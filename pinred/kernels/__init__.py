"""The compiled engine: a kernel made for one robot and one scene."""
