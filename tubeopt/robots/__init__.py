"""What a robot is: tubes, how they are held, and the sections that they form. Nothing symbolic."""
