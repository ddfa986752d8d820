"""Drivers of machines, as `anther.devices` wants them: what a machine does not do or tell raises DeviceError."""
