"""Tests of the console in a browser: a package, so that fixtures end with its last test."""
