"""How often is the diagnosis of a gap right, on synthetic sites whose truth it does not see?"""
