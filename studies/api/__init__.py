"""The commands as functions with typed keywords: the command line parses its words and calls these.

A function does the same stages as its command, with the same numbers and files. What is finished is reused,
and what was interrupted goes on. Progress goes to standard error.
"""
