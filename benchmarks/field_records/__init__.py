"""Records of batteries, houses, drugs and vehicles that were made to fool a study."""
