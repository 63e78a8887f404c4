"""OYMotion ROHand over Modbus RTU: platform `rohand` and its face."""
