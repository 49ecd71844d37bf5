"""The command line, with one file for each command.  It imports all other packages."""
