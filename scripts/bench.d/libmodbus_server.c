/* A peer of the benchmark: libmodbus' RTU server with ten holding registers. */
#include <modbus/modbus.h>
#include <stdio.h>

int main(int argc, char **argv) {
    modbus_t *line = argc == 2 ? modbus_new_rtu(argv[1], 38400, 'N', 8, 1) : NULL;
    modbus_mapping_t *registers = modbus_mapping_new(0, 0, 10, 0);
    if (!line || !registers || modbus_set_slave(line, 1) || modbus_connect(line)) { perror("libmodbus"); return 1; }
    unsigned char request[MODBUS_RTU_MAX_ADU_LENGTH];
    for (;;) {
        int length = modbus_receive(line, request);
        if (length > 0) modbus_reply(line, request, length, registers);
        if (length < 0) return 0;
    }
}
