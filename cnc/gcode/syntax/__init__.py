"""Text to statements: characters, words, expressions, grammar."""
