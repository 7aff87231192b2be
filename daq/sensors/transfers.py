"""smbus2 with prepared transfers, for a scan repeats the same fifty or so transfers every time.

The transfer on the wire is the same. The adapter's driver gets the written register and the bytes read as one transaction, in one
system call instead of two (`I2C_SLAVE` and `I2C_SMBUS`), without building ctypes objects for it. Adapters that support SMBus only
(those of PCs) are used through smbus2 itself.
"""

from collections.abc import Sequence
from ctypes import Array, c_char, create_string_buffer
from fcntl import ioctl
from typing import Any

from smbus2 import I2cFunc, SMBus, i2c_msg
from smbus2.smbus2 import I2C_M_RD, I2C_RDWR, I2C_SLAVE, i2c_rdwr_ioctl_data

_Prepared = tuple[i2c_rdwr_ioctl_data, "Array[c_char]"]


def prepared(bus: SMBus) -> Any:
    """The bus, with prepared transfers where its adapter supports them."""
    return PreparedBus(bus) if bus.funcs & I2cFunc.I2C else bus


class PreparedBus:
    """The calls of `daq.sensors.bus.I2cBus` on an open `SMBus`. Each raises OSError when the transfer fails."""

    def __init__(self, bus: SMBus) -> None:
        self.fd: int = bus.fd
        self.close = bus.close
        self._transact = bus.i2c_rdwr
        self._reads: dict[tuple[int, int, int], _Prepared] = {}
        self._transactions: dict[int, tuple[tuple[i2c_msg, ...], i2c_rdwr_ioctl_data]] = {}  # by id of the last message
        self._writes: dict[tuple[int, int], _Prepared] = {}  # by address and number of bytes with the register's

    def read_i2c_block_data(self, address: int, register: int, length: int, /) -> list[int]:
        transfer = self._reads.get((address, register, length)) or self._prepare_read(address, register, length)
        ioctl(self.fd, I2C_RDWR, transfer[0])
        return [*transfer[1].raw]

    def read_byte_data(self, address: int, register: int, /) -> int:
        return self.read_i2c_block_data(address, register, 1)[0]

    def write_i2c_block_data(self, address: int, register: int, data: Sequence[int], /) -> None:
        content = bytes((register, *data))
        transfer = self._writes.get((address, len(content))) or self._prepare_write(address, len(content))
        transfer[1].raw = content
        ioctl(self.fd, I2C_RDWR, transfer[0])

    def write_byte_data(self, address: int, register: int, value: int, /) -> None:
        self.write_i2c_block_data(address, register, (value,))

    def i2c_rdwr(self, *messages: i2c_msg) -> None:
        """Make one transaction. It is prepared once where it ends with a read, for drivers reuse such messages."""
        transaction = self._transactions.get(id(messages[-1]))
        if transaction is not None and transaction[0] == messages:
            ioctl(self.fd, I2C_RDWR, transaction[1])
        elif messages[-1].flags & I2C_M_RD:
            for address in {m.addr for m in messages}:
                self._check_free(address)
            data = i2c_rdwr_ioctl_data.create(*messages)
            self._transactions[id(messages[-1])] = messages, data
            ioctl(self.fd, I2C_RDWR, data)
        else:
            self._transact(*messages)

    def _prepare_read(self, address: int, register: int, length: int) -> _Prepared:
        self._check_free(address)
        buffer = create_string_buffer(length)
        select = i2c_msg(address, 0, 1, create_string_buffer(bytes((register,)), 1))
        transfer = i2c_rdwr_ioctl_data.create(select, i2c_msg(address, I2C_M_RD, length, buffer)), buffer
        self._reads[address, register, length] = transfer
        return transfer

    def _prepare_write(self, address: int, length: int) -> _Prepared:
        self._check_free(address)
        content = create_string_buffer(length)
        transfer = i2c_rdwr_ioctl_data.create(i2c_msg(address, 0, length, content)), content
        self._writes[address, length] = transfer
        return transfer

    def _check_free(self, address: int) -> None:
        """Raise OSError (busy) for a chip that a driver of the kernel uses; a transaction itself does not check."""
        ioctl(self.fd, I2C_SLAVE, address)
