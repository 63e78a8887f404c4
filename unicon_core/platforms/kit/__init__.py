"""What platforms share: commands, servo, base states, scene, clock and damping, one file each."""
