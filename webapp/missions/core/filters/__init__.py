"""Filter conditions on the rows of a table, as people write them: `class = 'car' AND confidence > 0.5`.

The text is parsed to a syntax tree (`parser.py`), and never inserted into another language such as SQL. Each
error has the position of its character.
"""
