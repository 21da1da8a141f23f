"""RR-8096 figure 5: two methods of pose extraction."""
