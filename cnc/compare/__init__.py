"""Two programs side by side: where their motion differs most."""
