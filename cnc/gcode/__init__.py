"""Program text to canonical blocks."""
