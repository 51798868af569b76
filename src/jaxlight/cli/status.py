"""The exit status of every command."""

SUCCESS = 0
FAILURE = 1
"""Ran, but without success: a fit that did not converge, a derivative that disagrees."""
BAD_INPUT = 2
INTERRUPTED = 130
"""By Ctrl-C, as shells count it."""
