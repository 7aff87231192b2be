"""The verbs of the command line, a file each: parse, call the public function, print, save.

Commands import heavy modules in their functions, so that `--help` and light verbs are fast.
"""
