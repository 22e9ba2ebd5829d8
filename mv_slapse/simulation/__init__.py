"""A rendered street whose camera, planes, movers and labels are known exactly."""
