"""The language of SINUMERIK."""
