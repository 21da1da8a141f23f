"""RR-8096: claims on a study of the active space telescope, and its comparison of pose methods."""
