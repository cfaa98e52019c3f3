"""What is watched while a network learns by rewards; here belongs nothing that changes what it learns."""
