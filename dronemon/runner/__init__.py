"""Flies a mission: links, patrol, the way home. It reads as the mission's story.

Its parts are imported one by one: who asks for the ground alone need not wait for the rest.
"""
