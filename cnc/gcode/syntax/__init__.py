"""From text to statements: scanner, grammar, words, expressions."""
