"""Every setting once: type, unit, limits, meaning, example; and the types that stages hand on.

In: nothing. Out: sections, ground classes, blocks, rules of hazard levels, languages, styles.
May import: sassgis.compiled, sassgis.errors, sassgis.grid, pydantic.
"""
