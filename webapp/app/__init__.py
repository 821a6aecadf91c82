"""What puts the program together: pages, commands and kinds of jobs, of missions and the sample too."""
