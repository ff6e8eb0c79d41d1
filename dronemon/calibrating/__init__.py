"""`dronemon calibrate`: what a mission has to say of its camera and detector, measured."""
