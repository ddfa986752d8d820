"""Drivers of machines, as `anther.robot.devices` wants them: what a machine does not do or tell raises DeviceError."""
