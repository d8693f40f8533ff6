"""Motor drivers by Trinamic (TMC2208, TMC2209, TMC2130, TMC5160), configured through the board."""
