"""From photogrammetry targets to poses of rigid bodies and deformations of the platform."""
