"""Contacts of whole systems: capture, release and touch-down, and motions of several phases."""
