"""The simulated vehicle: `python -m sim MISSION.yaml` runs its world, autopilot and camera.

The application meets it as it meets a drone, over MAVLink and a camera stream.
"""
