"""What drivers and emulators of robots behind DDS share: raw CDR in and out over CycloneDDS."""
