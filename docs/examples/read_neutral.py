"""Coefficients of an aircraft that `sideslip export --to neutral` wrote: python read_neutral.py aircraft.json V=20 alpha=0.05"""

import json
import math
import operator
import sys

TWO = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "**": operator.pow, "<": operator.lt,
       "<=": operator.le, ">": operator.gt, ">=": operator.ge, "min": min, "max": max, "abs": abs, "neg": operator.neg,
       "sign": lambda a: (a > 0) - (a < 0), "where": lambda c, a, b: a if c else b}  # fmt: skip


def value(tree, known):
    if not isinstance(tree, list):
        return known[tree] if isinstance(tree, str) else tree
    return (TWO.get(tree[0]) or getattr(math, tree[0]))(*(value(argument, known) for argument in tree[1:]))


def coefficients(model, **state):
    known = (
        {v["name"]: 0.0 for v in model["variables"]} | {n: c["value"] for n, c in model["constants"].items()} | state
    )
    for line in model["lines"]:
        known[line["name"]] = value(line["tree"], known)
    return {name: known[name] for name in model["outputs"]}


if __name__ == "__main__":
    with open(sys.argv[1], encoding="utf-8") as file:
        print(coefficients(json.load(file), **{n: float(v) for n, v in (word.split("=") for word in sys.argv[2:])}))
