"""The command line, a file a command.  Imports everything; nothing imports it."""
