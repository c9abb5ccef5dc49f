"""The arm as it really is: its machine data, nominal and true geometry, inverse kinematics."""
