"""Execution of plans on boards: pulse boards, line boards, homing."""
