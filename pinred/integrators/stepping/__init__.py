"""Building blocks of compiled steppers: step loop, kernel calls, rows and linear systems."""
