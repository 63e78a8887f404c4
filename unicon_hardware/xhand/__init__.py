"""RobotEra XHand1 through its maker's module: platform `xhand`."""
