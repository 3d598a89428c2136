"""What a fit takes as given, and by how much its numbers would move if it were not so."""
