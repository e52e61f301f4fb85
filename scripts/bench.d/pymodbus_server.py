"""A peer of the benchmark: pymodbus' RTU server with ten holding registers."""

import sys

from pymodbus.datastore import ModbusDeviceContext, ModbusSequentialDataBlock, ModbusServerContext
from pymodbus.framer import FramerType
from pymodbus.server import StartSerialServer

device = ModbusDeviceContext(hr=ModbusSequentialDataBlock(1, [7] * 10))
context = ModbusServerContext(devices={1: device}, single=False)
StartSerialServer(context, port=sys.argv[1], baudrate=38400, framer=FramerType.RTU)
