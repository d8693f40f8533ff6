"""The reader: program text to statements, by the tables of the Lark grammars."""
