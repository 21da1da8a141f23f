"""Claims of INRIA research report RR-8096 (Gayral and Daney, 2012), by what they are about."""
