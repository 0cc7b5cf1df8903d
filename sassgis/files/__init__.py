"""Files and folders, whatever is in them.

Results that appear whole or not at all, digests, saved arrays, what GDAL may open.
May import: sassgis.settings and below.
"""
