"""RH56 hands behind DDS services: the FTP and the DFX, which are two interfaces."""
