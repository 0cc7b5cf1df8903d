"""The federal minimal data model 166.1 and its transfer file (INTERLIS)."""
