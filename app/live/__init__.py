"""Live: robots stream in, estimates stream out, commands go back.

protocol.py   every message, as typed structures: what robots, servers and viewers say to each other
A robot's rows go through `messages` (checked), `log` (on disk, then acknowledged), `columns` (readable as a run while
it grows) and `workers` (estimated beside the event loop); `hub` ties them together and feeds the viewers.
"""
