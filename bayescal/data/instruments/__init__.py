"""What instruments read of the platform, as residuals of poses: whole poses or parts of them, points from stations."""
