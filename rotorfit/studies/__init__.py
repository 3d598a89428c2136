"""What is made of several fits, or before one."""
