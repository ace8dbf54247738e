"""The sandbox: one run or scenario simulated again and again while its effects are moved.

`prepared` a stretch made ready once · `cache` the few that are kept · `figure` what a page draws of one move.
"""
