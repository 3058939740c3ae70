"""What a file keeps of a study beside the amended model's posterior."""
