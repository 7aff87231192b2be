"""What the workflow answers: data, and the words made of it."""
