"""What every node needs of ROS: interfaces, messages, parameters, life, bags."""

__all__: list[str] = []
