"""What a posterior says of the motion: recordings' inputs played to the joint."""
