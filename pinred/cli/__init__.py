"""The command line, with one file for each group of commands.  It imports all other packages."""
