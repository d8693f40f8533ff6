"""The program of one control as a program of another, proved before it is written."""
