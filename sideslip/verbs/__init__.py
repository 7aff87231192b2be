"""The verbs of the command line, a file each: parse, call the public function, print, save.

Function bodies import what they need, when it is needed.
"""
